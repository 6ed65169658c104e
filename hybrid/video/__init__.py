"""Films: calibrated from chosen frames, every frame warped by the same maps, sound kept.

Needs the package PyAV (`pip install 'straightlens[video]'`), imported when a film is opened.
"""

from hybrid.video.choose import chosen_frames as chosen_frames
from hybrid.video.film import FilmReport as FilmReport
from hybrid.video.film import calibrate_film as calibrate_film
from hybrid.video.film import rectify_film as rectify_film
from hybrid.video.source import Film as Film
from hybrid.video.write import CODECS as CODECS
from hybrid.video.write import PRESETS as PRESETS
from hybrid.video.write import Encoding as Encoding
