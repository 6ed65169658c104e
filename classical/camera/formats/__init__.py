"""Camera files of other programs, written and read.

The table `CAMERA_FORMATS` names them; each has a module that turns a lens into text, tells its
files by their content, and reads them. Reading gives Kannala–Brandt lenses.
"""

from classical.camera.formats.read import cameras_of as cameras_of
from classical.camera.formats.read import chosen_camera as chosen_camera
from classical.camera.formats.read import kind_of as kind_of
from classical.camera.formats.read import read_lens as read_lens
from classical.camera.formats.record import Content as Content
from classical.camera.formats.record import Record as Record
from classical.camera.formats.record import read_content as read_content
from classical.camera.formats.record import shown as shown
from classical.camera.formats.straightlens import lens_fields as lens_fields
from classical.camera.formats.table import CAMERA_FORMATS as CAMERA_FORMATS
from classical.camera.formats.table import CameraFormat as CameraFormat
from classical.camera.formats.table import Export as Export
