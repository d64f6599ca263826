"""What the exporter approximated or left out, told to the user instead of silently dropped."""

from dataclasses import asdict, dataclass

NAMED_OBJECTS = 3


@dataclass(frozen=True)
class Note:
    """One thing that differs from what Blender would render.

    Parameters
    ----------
    object : str
        Name of the object, lamp, image or world it concerns; of a material's, of the objects that wear it.
    feature : str
        The node and socket, or the setting, as Blender's interface calls it.
    effect : str
        What was done instead, e.g. ``"ignored"``.
    material : str
        Name of the material it concerns, or empty.
    """

    object: str
    feature: str
    effect: str
    material: str = ""

    def __str__(self):
        where = f"{self.object}, material {self.material}" if self.material else self.object
        return f"{where}: {self.feature}: {self.effect}"

    def to_dict(self):
        """JSON-able form."""
        return asdict(self)


class Notes:
    """Notes in the order they arose, each only once; of equal ones on a material, one that names all objects.

    Parameters
    ----------
    material : str
        Name of the material that all of these notes concern, if they do.
    """

    def __init__(self, material=""):
        self._material = material
        self._objects = {}  # by material, feature and effect: names, as keys of a dict to keep their order

    def add(self, object_name, feature, effect):
        """Remember that `feature` of `object_name` had this `effect`.

        Of a material's own notes the name is that of the material, or of an image that it reads.
        """
        self._objects.setdefault((self._material, feature, effect), {})[object_name] = None

    def worn(self, object_name, notes):
        """Take over the notes on a material that an object wears."""
        for (material, feature, effect), names in notes._objects.items():
            own = {object_name: None} if set(names) == {material} else names
            self._objects.setdefault((material, feature, effect), {}).update(own)

    def __iter__(self):
        for (material, feature, effect), names in self._objects.items():
            if material:
                names = list(names)
                more = len(names) - NAMED_OBJECTS
                shown = ", ".join(names[:NAMED_OBJECTS]) + (f" and {more} more" if more > 0 else "")
                yield Note(shown, feature, effect, material)
            else:
                for name in names:
                    yield Note(name, feature, effect)
