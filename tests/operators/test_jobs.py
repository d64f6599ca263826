"""Work in a thread that asks the main thread for what only it may do."""

import threading
import time

import pytest

from holopath_addon import engine
from holopath_addon.operators import session
from holopath_addon.operators.jobs import Job
from tests.patience import NEVER


def serve_until_over(job):
    while job.running:
        job.answer_query()
        time.sleep(0.01)


def test_a_question_is_answered_by_whoever_serves():
    job = Job(lambda progress: (threading.current_thread(), job.query(threading.current_thread)))
    job.start()
    serve_until_over(job)
    worker, server = job.result
    assert server is threading.main_thread() and worker is not server
    job = Job(lambda progress: job.query(threading.current_thread))  # without a thread of its own
    job.run()
    assert job.result is threading.main_thread()


def test_an_error_in_the_answer_is_the_works():
    def refuse():
        raise engine.InvalidInput("No.")

    job = Job(lambda progress: job.query(refuse))
    job.start()
    serve_until_over(job)
    assert isinstance(job.error, engine.InvalidInput)


def test_nobody_need_answer_a_canceled_job():
    job = Job(lambda progress: job.query(lambda: None))
    job.start()
    job.cancel()
    assert job.wait(NEVER) and isinstance(job.error, engine.Cancelled)


def test_pictures_are_taken_once():
    job = Job(lambda progress: None)
    assert job.take_offer() is None
    job.offer("first")
    job.offer("second")
    assert job.take_offer() == "second" and job.take_offer() is None


def test_compiling_is_told_while_it_happens(backend):
    """The job says so between reports while a program is compiled; not for programs on disk."""
    import drjit as dr
    import mitsuba as mi

    new = time.time_ns() % 1_000_003  # no run before had a program with this number

    def compute():
        dr.eval(dr.arange(mi.Float, 5) * dr.cos(mi.Float(new) + dr.arange(mi.Float, 5) ** 3) + new)

    states = []

    def work(progress):
        for done, message in ((0.0, "Starting"), (0.1, "First"), (0.2, "Second")):
            progress(done, message)
            states.append((job.compiling, session.progress_text(job)))
            compute()

    job = Job(work)
    job.run()
    assert job.error is None
    assert states == [(False, "Starting…"), (True, "10% Compiling"), (False, "20% Second")]
    job.cancel()
    assert session.progress_text(job) == "Canceling…"


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


def test_work_for_the_main_thread(monkeypatch):
    """Work runs at once on it; from another thread, if nobody answers, there after a while. Errors come through."""
    import threading

    from holopath_addon.operators import jobs

    monkeypatch.setattr(jobs, "MAIN_THREAD_TIMEOUT", 0.05)
    assert jobs.run_on_main_thread(threading.current_thread) is threading.main_thread()
    found = []
    thread = threading.Thread(target=lambda: found.append(jobs.run_on_main_thread(threading.current_thread)))
    thread.start()
    thread.join(NEVER)
    assert found == [thread]

    def fail():
        found.append(None)
        raise ValueError("no")

    def expect():
        with pytest.raises(ValueError, match="no"):
            jobs.run_on_main_thread(fail)

    thread = threading.Thread(target=expect)
    thread.start()
    thread.join(NEVER)
    assert found[1:] == [None]
