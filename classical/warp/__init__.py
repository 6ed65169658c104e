"""From a fisheye camera to a straight picture and back: target camera, maps, resampling."""

from classical.warp.maps import WarpMaps as WarpMaps
from classical.warp.maps import distort_maps as distort_maps
from classical.warp.maps import undistort_maps as undistort_maps
from classical.warp.remap import remap as remap
from classical.warp.stmap import is_stmap_name as is_stmap_name
from classical.warp.stmap import read_stmap as read_stmap
from classical.warp.stmap import read_stmap_note as read_stmap_note
from classical.warp.stmap import write_stmap as write_stmap
from classical.warp.target import pinhole_target as pinhole_target
