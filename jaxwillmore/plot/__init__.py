"""Pictures for people: a surface with a field on it, the curves of a run, a branch.

Needs the extra `viz` (matplotlib, and PyVista for the better pictures); importing this package
does not import them.
"""

from ._branch import branch_picture as branch_picture
from ._error import PlotError as PlotError
from ._history import history_picture as history_picture
from ._orders import orders_picture as orders_picture
from ._overlay import overlay_picture as overlay_picture, profile_picture as profile_picture
from ._surface import surface_picture as surface_picture
