"""Errors of devices."""


class DeviceLost(ConnectionError):
    """Raised where a device does not answer or is gone; the text names the remedy."""
