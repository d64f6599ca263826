"""What a Mitsuba scene may hold that a hologram does not show: refused with a sentence, or told of."""

import mitsuba as mi

from .errors import InvalidInput
from .lobes import nested_in, parts_of

MOST_NAMES = 3
# by Mitsuba's name of the type: plugins, and what is shown instead
SPECTRA = {
    "BlackBodySpectrum": "blackbody",
    "RegularSpectrum": "regular",
    "IrregularSpectrum": "irregular",
}
POLARISING = {
    "LinearPolarizer": "polarizer",
    "LinearRetarder": "retarder",
    "CircularPolarizer": "circular",
}


def unmodelled(scene):
    """What of a scene is shown otherwise than Mitsuba's own integrators might.

    Parameters
    ----------
    scene : mitsuba.Scene

    Returns
    -------
    list of str
        A warning each.

    Raises
    ------
    InvalidInput
        If a part of it cannot be evaluated at all.
    """
    parts, kinds = parts_of(scene), {}
    for part in parts:
        kinds.setdefault(part.class_name().partition("[")[0], part)
    spectrum = next((SPECTRA[kind] for kind in kinds if kind in SPECTRA), None)
    if spectrum:
        raise InvalidInput(
            f"The scene has a spectrum of type '{spectrum}', which Mitsuba evaluates in its spectral variants only: "
            "give a colour instead (<rgb>), or <spectrum> with values by wavelength."
        )
    warnings = []
    if any(isinstance(part, mi.Medium) for part in parts):
        around = [part for part in parts if any(isinstance(inner, mi.Medium) for inner in nested_in(part))]
        warnings.append(
            f"Scattering media are not modelled: what is in or around {_named(around)} is shown as clear."
        )
    panes = [name for kind, name in POLARISING.items() if kind in kinds]
    if panes:
        warnings.append(f"Polarization is not modelled: a {' or '.join(panes)} only dims the light.")
    return warnings


def _named(parts):
    """The ids of some parts, their types where they have none."""
    names = [part.id() or f"a {part.class_name()}" for part in parts[:MOST_NAMES]]
    return ", ".join(names) + (f" and {len(parts) - MOST_NAMES} more" if len(parts) > MOST_NAMES else "")
