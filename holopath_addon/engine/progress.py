"""How long work tells how far it is."""

from collections.abc import Callable

# ``progress(done, message)``, done in 0..1; it may raise `Cancelled`, which stops the work.
Progress = Callable[[float, str], None]
# ``progress(done)`` of work whose caller knows what to call it.
PartProgress = Callable[[float], None]
