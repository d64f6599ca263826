"""What goes wrong between a program and a device."""


class DeviceLost(ConnectionError):
    """The device does not answer, or is gone; the text says so in a sentence, and what to do."""
