"""Conversion of numbers that Blender keeps in single precision."""


def tidy(value: float) -> float:
    """Round a number of single precision to the decimal number that it stands for: 6 significant digits."""
    return float(f"{value:.6g}")
