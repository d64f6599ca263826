"""Work in a thread that asks the main thread for what only it may do."""

import threading
import time

import pytest

from holopath_addon import engine
from holopath_addon.operators.jobs import Job


def serve_until_over(job):
    while job.running:
        job.serve()
        time.sleep(0.01)


def test_a_question_is_answered_by_whoever_serves():
    job = Job(lambda progress: (threading.current_thread(), job.ask(threading.current_thread)))
    job.start()
    serve_until_over(job)
    worker, server = job.result
    assert server is threading.main_thread() and worker is not server
    job = Job(lambda progress: job.ask(threading.current_thread))  # without a thread of its own
    job.run()
    assert job.result is threading.main_thread()


def test_an_error_in_the_answer_is_the_works():
    def refuse():
        raise engine.InvalidInput("No.")

    job = Job(lambda progress: job.ask(refuse))
    job.start()
    serve_until_over(job)
    assert isinstance(job.error, engine.InvalidInput)


def test_nobody_need_answer_a_cancelled_job():
    job = Job(lambda progress: job.ask(lambda: None))
    job.start()
    job.cancel()
    assert job.wait(5) and isinstance(job.error, engine.Cancelled)


def test_pictures_are_taken_once():
    job = Job(lambda progress: None)
    assert job.take() is None
    job.offer("first")
    job.offer("second")
    assert job.take() == "second" and job.take() is None


def test_time_left(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    job = Job(lambda progress: None)
    job.done = 0.5
    assert job.remaining is None  # too soon to tell
    now[0] += 6
    assert job.remaining == pytest.approx(6)
    job.done = 0.01
    assert job.remaining is None
