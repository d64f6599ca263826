"""Speed against accuracy, all methods side by side: ``make chart``, ``make chart-quick``."""
