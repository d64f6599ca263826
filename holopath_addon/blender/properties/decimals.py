"""Numbers of properties, which Blender keeps in single precision."""


def tidy(value: float) -> float:
    """Blender's single precision as the decimal number that was meant."""
    return float(f"{value:.6g}")
