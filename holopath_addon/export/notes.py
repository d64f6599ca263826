"""Notes for the user on everything that the exporter approximated or omitted."""

from dataclasses import asdict, dataclass

NAMED_OBJECTS = 3


@dataclass(frozen=True)
class Note:
    """A note on one difference from Blender's render.

    Parameters
    ----------
    object : str
        Name of the object, light, image or world; for a material's note, of the objects that use the material.
    feature : str
        The node and socket, or the setting, by its name in Blender's interface.
    effect : str
        The effect, e.g. ``"ignored"``.
    material : str
        Name of the material, or empty.
    """

    object: str
    feature: str
    effect: str
    material: str = ""

    def __str__(self):
        where = f"{self.object}, material {self.material}" if self.material else self.object
        return f"{where}: {self.feature}: {self.effect}"

    def to_dict(self):
        """JSON form."""
        return asdict(self)


class Notes:
    """Distinct notes in their order; equal notes on a material become one that names all objects.

    Parameters
    ----------
    material : str
        Name of the material of all notes, or empty.
    """

    def __init__(self, material=""):
        self._material = material
        self._objects = {}  # by material, feature and effect: names, as keys of a dict to keep their order

    def add(self, object_name, feature, effect):
        """Add a note.

        Parameters
        ----------
        object_name, feature, effect : str
            See `Note`. In a material's notes the name is that of the material, or of an image that it reads.
        """
        self._objects.setdefault((self._material, feature, effect), {})[object_name] = None

    def add_material(self, object_name, notes):
        """Add the `Notes` on a material that an object uses."""
        for (material, feature, effect), names in notes._objects.items():
            own = {object_name: None} if set(names) == {material} else names
            self._objects.setdefault((material, feature, effect), {}).update(own)

    def __iter__(self):
        for (material, feature, effect), names in self._objects.items():
            if material:
                names = list(names)
                more = len(names) - NAMED_OBJECTS
                listing = ", ".join(names[:NAMED_OBJECTS]) + (f" and {more} more" if more > 0 else "")
                yield Note(listing, feature, effect, material)
            else:
                for name in names:
                    yield Note(name, feature, effect)
