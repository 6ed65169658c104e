"""Straightlens: one fisheye photograph in, its lens and the straight photograph out."""

from classical.camera import KannalaBrandt as KannalaBrandt
from classical.camera import Pinhole as Pinhole
from hybrid.camera_files import CameraFile as CameraFile
from hybrid.camera_files import read_camera as read_camera
from hybrid.camera_files import write_camera as write_camera
from hybrid.config import RectifyConfig as RectifyConfig
from hybrid.images import Picture as Picture
from hybrid.images import read_picture as read_picture
from hybrid.images import write_picture as write_picture
from hybrid.overlay import draw_curves as draw_curves
from hybrid.pipeline import Rectifier as Rectifier
from hybrid.pipeline import calibrate as calibrate
from hybrid.pipeline import rectify as rectify
from hybrid.result import Calibration as Calibration
from hybrid.result import Quality as Quality
from hybrid.result import Rectification as Rectification
from hybrid.result import RectificationError as RectificationError
