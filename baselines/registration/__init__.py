"""Registration without learning: a part and a kit as height images along the insertion axis, searched, then refined.

Read it in the order of the method: `sources` (volumes), `baselines.completion.planes` (plates look up), `cavity` (what is cut
into one), `faces` (on which the part may stand), `relief` (its lower envelope, grown by the clearance), `search` (all
turns and places), `refine` (the last millimetre) and `method`, which joins them.
"""

from baselines.registration.method import Registration

__all__ = ["Registration"]
