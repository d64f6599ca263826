"""Names of the version before: they work, and a warning says the current name."""

from dataclasses import replace

import pytest

from holopath_addon import engine
from holopath_addon.engine.planning.fixable import FIXABLE
from holopath_addon.engine.settings import DECLARED, former_names


@pytest.mark.parametrize(
    ("former", "current", "said"),
    [
        (
            {"most_hits": 3},
            {"max_specular_depth": 3},
            "The setting most_hits is called max_specular_depth now.",
        ),
        ({"quality": "full"}, {"quality": "high"}, "The quality full is called high now."),
        ({"fixed": {"grey": 1}}, {"fixed": {"gray": 1}}, "The decision grey is called gray now."),
    ],
)
def test_settings(former, current, said):
    with pytest.warns(DeprecationWarning) as warned:
        settings = engine.Settings(**former)
    assert str(warned[0].message) == f"{said} The next version will not accept the old name."
    assert warned[0].filename == __file__  # of the line to change
    assert settings == engine.Settings(**current) == replace(settings)


def test_current_names_give_no_warning(recwarn):
    assert former_names.with_current_names("setting", {"frames": 3}) == {"frames": 3}
    assert former_names.current_name("nothing of the kind", "full") == "full"
    assert engine.Settings(max_specular_depth=2, fixed={"gray": 0}).fixed == {"gray": 0} and not recwarn.list


def test_former_names_lead_to_names_that_exist():
    for kind, known in (
        ("setting", DECLARED),
        ("decision", FIXABLE),
        ("quality", DECLARED["quality"].chosen),
    ):
        for old, new in former_names.FORMER_NAMES[kind].items():
            assert old not in known and new in known


def test_former_names_of_arguments():
    """The values are those of the current names, and the warning is of the line to change."""

    @former_names.accepts_former_names
    def encode(field, *, has_stop=True):
        return field, has_stop

    with pytest.warns(DeprecationWarning, match="The argument aperture is called has_stop now") as warned:
        assert encode(3, aperture=False) == (3, False)
    assert warned[0].filename == __file__
    assert encode(3, has_stop=False) == (3, False) and encode(3) == (3, True)
    with pytest.warns(DeprecationWarning), pytest.raises(TypeError, match="former and its current name"):
        encode(3, aperture=False, has_stop=False)
