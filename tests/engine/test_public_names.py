"""Examples in the docstrings of the engine's public names."""

import doctest

import pytest

from holopath_addon import engine

EXAMPLES = [
    example
    for name in engine.__all__
    for example in doctest.DocTestFinder().find(getattr(engine, name), name, globs={})
    if example.examples
]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
def test_examples(backend, example):
    output = []
    doctest.DocTestRunner().run(example, out=output.append)
    assert not output, "".join(output)


def test_what_users_call_first_has_examples():
    names = {example.name for example in EXAMPLES}
    assert names >= {
        "Camera",
        "Hologram",
        "Preview",
        "Refocuser",
        "Settings",
        "WaveField",
        "plan",
        "render",
        "encode",
    }
    assert names >= {"psnr", "reconstruct", "to_rgb"}
