"""What runs, in a browser of this machine.

``server`` answers with what a ``Site`` has. That of a fit is ``fit_site``: ``watch`` reads the folder that a
fit writes to and says what is there, as JSON and pictures; the page ``live.html`` asks every second and draws
it. Nothing flows back to the fit.
"""

from .fit_site import FitSite
from .server import ADDRESS, HTML, LIVE_POLICY, PORT, REPORT_POLICY, Answer, Site, make_server
from .watch import Watch

__all__ = ["ADDRESS", "HTML", "LIVE_POLICY", "PORT", "REPORT_POLICY", "Answer", "FitSite", "Site", "Watch",
           "make_server"]
