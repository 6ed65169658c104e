"""Camera models: pixels to unit rays and back."""

from classical.camera.base import Camera as Camera
from classical.camera.base import pixel_grid as pixel_grid
from classical.camera.convert import Residual as Residual
from classical.camera.convert import conversion_residual as conversion_residual
from classical.camera.convert import nearest_division as nearest_division
from classical.camera.convert import nearest_kannala_brandt as nearest_kannala_brandt
from classical.camera.convert import nearest_ocam as nearest_ocam
from classical.camera.convert import radial_coefficients as radial_coefficients
from classical.camera.division import Division as Division
from classical.camera.kannala_brandt import KannalaBrandt as KannalaBrandt
from classical.camera.kannala_brandt import UnprojectionJacobian as UnprojectionJacobian
from classical.camera.ocam import Ocam as Ocam
from classical.camera.pinhole import Pinhole as Pinhole
