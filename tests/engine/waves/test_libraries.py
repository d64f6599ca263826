"""Choice of the library that computes waves, memory of a graphics card, and Dr.Jit's numbers."""

import dataclasses

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine import memory
from holopath_addon.engine.planning import planner
from holopath_addon.engine.scene import variants
from holopath_addon.engine.waves import libraries
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Encoding, Request


@pytest.fixture
def card(monkeypatch):
    """A machine with a card, and libraries that are said to be there."""
    monkeypatch.delenv(libraries.VARIABLE, raising=False)
    monkeypatch.setattr(variants, "on_card", lambda: True)

    def with_(*names, problem=""):
        monkeypatch.setattr(libraries, "find_spec", lambda name: name in names or None)
        monkeypatch.setattr(libraries, "_problem", lambda name, device: problem)

    return with_


def test_a_card_without_a_library(card):
    """One sentence with what to do; the processor computes."""
    card()
    name, advice = libraries.choose()
    assert name == "numpy" and advice == libraries.describe()
    assert "neither CuPy nor PyTorch is installed" in advice and "pip install 'cupy-cuda12x[ctk]'" in advice
    assert planner.decide_library({}).warnings == (advice,)


def test_the_library_that_is_installed_computes(card):
    card("torch")
    assert libraries.choose() == ("torch", "") and "by PyTorch" in libraries.describe()
    card("cupy", "torch", problem="CuPy cannot compute there (CUDA driver version is insufficient)")
    name, advice = libraries.choose()
    assert name == "numpy" and "driver version is insufficient" in advice and advice.count(".") == 1
    assert "a newer NVIDIA driver" in advice and "pip" not in advice
    assert planner.decide_library({}).warnings == (advice,)


def test_without_a_card_the_processor_computes(monkeypatch):
    monkeypatch.delenv(libraries.VARIABLE, raising=False)
    monkeypatch.setattr(variants, "on_card", lambda: False)
    assert libraries.choose() == ("numpy", "")
    assert libraries.empty_array("numpy") is libraries.PROCESSOR
    assert planner.decide_library({}) == planner.Decided("numpy")


@pytest.mark.parametrize(
    ("named", "says"), [("jax", "set it to one of"), ("cupy", "CuPy is not installed: `pip")]
)
def test_what_is_named_and_cannot_be(monkeypatch, named, says):
    monkeypatch.setenv(libraries.VARIABLE, named)
    monkeypatch.setattr(libraries, "_problem", lambda name, device: "CuPy is not installed")
    with pytest.raises(engine.InvalidInput, match=says) as refused:
        libraries.choose()
    assert str(refused.value).count(".") == 1


def test_a_card_that_is_too_small(card, monkeypatch):
    """Is left alone, and the plan says so."""
    card("torch")
    needs = {"wave tracing": 2e9, "propagation": 1e9, "reconstruction": 0.5e9, "sgd": 3e9, "joint": 0.9e9}
    library = planner.decide_library(needs, ["sgd", "joint"], 1 << 30)
    assert library.value == "numpy" and not library.warnings
    waves, memory = map(str, library.decisions)
    assert "PyTorch would need 2 GB of the card's memory, of which 1.07 GB are free" in waves
    assert (
        "wave tracing 2 GB, propagation 1 GB, reconstruction 0.5 GB, sgd 3 GB, joint 0.9 GB; 1.07 GB"
        in memory
    )
    assert "(left to the processor: sgd; in smaller batches, which fit: joint)" in memory
    library = planner.decide_library(needs | {"wave tracing": 1e9}, [], 1 << 30)
    assert library.value == "torch" and "PyTorch" in str(library.decisions[0])
    assert str(planner.decide_library(needs, [], 4 << 30).decisions[1]).endswith("; 4.29 GB free (all fit)")
    monkeypatch.setattr(libraries, "empty_array", lambda name: "an array on the card")
    monkeypatch.setattr(libraries, "on_card", lambda array: (8 << 30, 1 << 30))
    data = np.ones(3)
    assert libraries.by_card(lambda given: given is data, data, 2e9) == (True, "")


class OutOfMemoryError(RuntimeError):
    """Error with the name of those of CuPy and PyTorch."""


@pytest.mark.parametrize(
    ("error", "ran_out"),
    [
        (OutOfMemoryError("Out of memory allocating 512 bytes"), True),
        (RuntimeError("cuFFT error: CUFFT_ALLOC_FAILED"), True),
        (RuntimeError("jit_malloc(): out of memory! Could not allocate 512 bytes of device memory."), True),
        (RuntimeError("cuFFT error: CUFFT_INVALID_SIZE"), False),
        (MemoryError("out of memory"), False),  # the machine's, which the processor would run out of, too
    ],
)
def test_errors_of_a_card_s_memory(error, ran_out):
    assert libraries.out_of_memory(error) == ran_out


def test_memory_that_runs_out_in_the_middle(card, monkeypatch, field):
    """The processor goes on, and a sentence says so; other errors are as they are."""
    card("torch")
    monkeypatch.setattr(libraries, "empty_array", lambda name: "an array on the card")
    monkeypatch.setattr(libraries, "on_card", lambda array: None)
    monkeypatch.setattr(libraries, "like", lambda data, array: None)
    errors = [OutOfMemoryError(), ValueError()]

    def work(data):
        if data is None:
            raise errors.pop(0)
        return data.sum()

    assert libraries.by_card(work, np.ones(3), 0) == (3, libraries.RAN_OUT)
    with pytest.raises(ValueError):
        libraries.by_card(work, np.ones(3), 0)

    encoded = engine.encode

    def on_a_full_card(field, *rest, **options):
        if field.data is None:
            raise OutOfMemoryError
        return encoded(field, *rest, **options)

    monkeypatch.setattr(engine, "encode", on_a_full_card)
    phase = pipeline.encode(field, Encoding("dpac"), lambda done, message: None)
    assert phase.report["advice"].endswith(libraries.RAN_OUT)
    np.testing.assert_array_equal(phase.data, encoded(field, "dpac").data)


def test_refocusing_says_that_memory_ran_out(card, build, camera, small, monkeypatch):
    """The plan of the render says so, besides the field's warnings; its images are there."""
    scene, settings = build.three_planes(), engine.Settings(frames=1, max_depth=1, quality="draft")
    plan = engine.plan(scene, camera, small, settings)
    field = engine.render(scene, camera, small, settings, plan)
    refocused = engine.reconstruct
    card("torch")
    monkeypatch.setattr(libraries, "empty_array", lambda name: "an array on the card")
    monkeypatch.setattr(libraries, "on_card", lambda array: None)
    monkeypatch.setattr(libraries, "like", lambda data, array: None)

    def on_a_full_card(field, *rest):
        if field.data is None:
            raise OutOfMemoryError
        return refocused(field, *rest)

    monkeypatch.setattr(engine, "reconstruct", on_a_full_card)
    field.plan["warnings"] = ["Of the waves."]
    result = pipeline.compute(Request(small, settings, [1.0], scene=scene, camera=camera), rendered=field)
    assert result.plan.warnings[-2:] == ("Of the waves.", libraries.RAN_OUT)
    np.testing.assert_array_equal(result.images, refocused(field, [1.0]))


def test_memory_of_the_machine_is_no_card_s():
    assert memory.on_card(np.ones(3)) is None
    assert memory.on_card(pytest.importorskip("array_api_strict").ones(3)) is None


@pytest.mark.oracle
def test_numbers_go_between_dr_jit_and_torch_without_a_copy(backend):
    torch, mi = pytest.importorskip("torch"), pytest.importorskip("mitsuba")
    on = torch.empty(0, dtype=torch.complex64)
    values = mi.Float(np.arange(10, dtype=np.float32))
    waves = libraries.from_drjit(values, on)
    expected = np.arange(0, 10, 2) + 1j * np.arange(1, 10, 2)
    np.testing.assert_array_equal(np.asarray(waves), expected)
    np.testing.assert_array_equal(libraries.from_drjit(values, libraries.PROCESSOR), expected)
    if variants.activate() == variants.LLVM:
        assert waves.data_ptr() == np.asarray(values).ctypes.data
    ones = torch.ones(8)
    there = mi.Float(ones)
    assert np.array_equal(np.asarray(there), np.ones(8))


@pytest.mark.oracle
def test_a_torch_for_processors_is_no_card_s():
    torch = pytest.importorskip("torch")
    if torch.cuda.is_available():
        pytest.skip("this machine has a card")
    assert "PyTorch cannot compute there" in libraries._problem("torch", "cuda")
    assert libraries._problem("torch", "cpu") == ""


@pytest.mark.oracle
@pytest.mark.parametrize("despeckle", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_fields_and_phases_are_those_of_numpy(build, camera, small, monkeypatch, despeckle):
    """Compare rays to phases with PyTorch on the processor; several planes, and despeckling."""
    pytest.importorskip("torch")
    scene, settings = (
        build.three_planes(),
        engine.Settings(frames=2, despeckle=despeckle, planes=2, max_depth=1),
    )
    found = []
    for name in ("numpy", "torch"):
        monkeypatch.setenv(libraries.VARIABLE, name)
        plan = engine.plan(scene, camera, small, settings)
        assert plan.library == name
        field = engine.render(scene, camera, small, settings, plan)
        assert field.plan["library"] == name and isinstance(field.data, np.ndarray)
        phase = pipeline.encode(field, Encoding("sgd"), lambda done, message: None, max_steps=2)
        image, notes = pipeline.reconstruct(field, [1.0], None, lambda done, message: None)
        assert not notes
        found.append((field.data, image, np.exp(1j * phase.data)))
    for expected, values in zip(*found, strict=True):
        assert isinstance(values, np.ndarray)
        assert np.linalg.norm(values - expected) < 1e-4 * np.linalg.norm(expected)


def test_memory_that_runs_out_while_waves_are_moved(build, camera, small, monkeypatch):
    """The processor begins the waves anew, and the field's plan says so."""
    from holopath_addon.engine.rendering import fields

    scene, settings = build.three_planes(), engine.Settings(frames=1, max_depth=1, quality="draft")
    plan = engine.plan(scene, camera, small, settings)
    expected = engine.render(scene, camera, small, settings, plan)

    def empty_array(name):
        if name == "torch":
            raise OutOfMemoryError
        return libraries.PROCESSOR

    monkeypatch.setattr(fields.libraries, "empty_array", empty_array)
    field = engine.render(scene, camera, small, settings, engine.Plan(**vars(plan) | {"library": "torch"}))
    np.testing.assert_array_equal(field.data, expected.data)
    assert field.plan["library"] == "numpy" and libraries.RAN_OUT in field.plan["warnings"]


def test_phases_are_found_where_the_plan_says(build, camera, small, as_on_a_card, monkeypatch):
    """The plan's memory decides; without one, as of a plan without a card, the field's size does."""
    scene, settings = build.two_planes(build.emissive), engine.Settings(frames=1, quality="draft", planes=1)
    needed = []

    def by_card(work, data, count):
        needed.append(count)
        return work(data), ""

    monkeypatch.setattr(libraries, "by_card", by_card)
    as_on_a_card(64 << 30)
    plan = engine.plan(scene, camera, small, settings)
    data = np.ones((1, 1, 128, 128), np.complex64)
    for planned in (plan, dataclasses.replace(plan, card_memory={})):
        field = engine.WaveField(data, small, camera, plan.near, planned.to_dict())
        pipeline.encode(field, Encoding("dpac"), lambda done, message: None, scene, settings)
    assert needed == [plan.card_memory["dpac"], memory.encoding_on_card(data.nbytes)]


@pytest.mark.parametrize(("free", "sizes"), [(None, [24]), (40 << 20, [5, 5, 4, 5, 5]), (1 << 20, [1] * 24)])
def test_batches_of_frames_go_by_what_a_card_has_free(monkeypatch, free, sizes):
    """Half of it, and a frame at least."""
    from holopath_addon.engine.encoding import encoder

    monkeypatch.setattr(encoder, "on_card", lambda array: free and (free, free))
    groups = encoder._groups(np.empty((24, 2)), 4 << 20)
    assert [each.stop - each.start for each in groups] == sizes
