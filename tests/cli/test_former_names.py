"""Names of the version before on the command line."""

from holopath_addon import cli, engine


def test_former_names_on_the_command_line(capsys):
    parser = cli._parser(engine.BakeStore.default())
    for words, name, value, said in (
        (
            ["plan", "a.xml", "--most-hits", "3"],
            "max_specular_depth",
            3,
            "--most-hits is called --max-specular-depth",
        ),
        (["plan", "a.xml", "--fix", "grey=1"], "fixed", {"gray": 1}, "The decision grey is called gray"),
        (["stream", "out", "--packing", "colour"], "packing", "color", "The packing colour is called color"),
        (
            ["import", "a.png", "--out", "o", "--packing", "colour"],
            "packing",
            "color",
            "The packing colour is called",
        ),
    ):
        assert getattr(parser.parse_args(words), name) == value
        assert capsys.readouterr().err.startswith(f"holopath: {said}")
