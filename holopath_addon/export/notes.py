"""What the exporter approximated or left out, told to the user instead of silently dropped."""

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Note:
    """One thing that differs from what Blender would render.

    Parameters
    ----------
    object : str
        Name of the object, material, light or world it concerns.
    feature : str
        The Blender feature, as the interface calls it.
    effect : str
        What was done instead, e.g. ``"ignored"``.
    """

    object: str
    feature: str
    effect: str

    def __str__(self):
        return f"{self.object}: {self.feature}: {self.effect}"

    def to_dict(self):
        """JSON-able form."""
        return asdict(self)


class Notes:
    """Notes in the order they arose, each only once."""

    def __init__(self):
        self._notes = {}

    def add(self, object_name, feature, effect):
        """Remember that `feature` of `object_name` had this `effect`."""
        self._notes[Note(object_name, feature, effect)] = None

    def __iter__(self):
        return iter(self._notes)
