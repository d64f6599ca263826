"""How long tests wait. A processor may be slow, and other programs may have most of it: no claim rests on its speed.

Where something has to end soon, what goes wrong takes longer than `SOON`.
"""

SOON = 60.0  # seconds; what is there within a second on an idle machine
NEVER = 600.0  # seconds; nobody waits so long, unless something hangs
