"""What is said of a hologram that was computed."""

from holopath_addon.workflow import pipeline


def test_what_to_know_of_baked_light():
    bake = {"note": "", "coarser": 1.2, "traced": ()}
    assert pipeline.bake_notes(None) == pipeline.bake_notes(bake) == []
    bake = {"note": "It was torn.", "coarser": 2.04, "traced": tuple("abcdefghij")}
    torn, coarse, traced = pipeline.bake_notes(bake)
    assert torn == "It was torn." and "2.0 times larger" in coarse
    assert traced.startswith("10 shapes'") and traced.endswith("h, ....")
