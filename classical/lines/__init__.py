"""From a picture or a heatmap to curves that may be images of straight lines."""

from classical.lines.curve import Curve as Curve
from classical.lines.image_circle import ImageCircle as ImageCircle
from classical.lines.image_circle import find_image_circle as find_image_circle
from classical.lines.joining import JoinConfig as JoinConfig
from classical.lines.joining import join_curves as join_curves
from classical.lines.rim import find_rim as find_rim
from classical.lines.tracing import TracingConfig as TracingConfig
from classical.lines.tracing import trace_further as trace_further
from classical.lines.vectorise import HeatmapCurvesConfig as HeatmapCurvesConfig
from classical.lines.vectorise import ImageCurvesConfig as ImageCurvesConfig
from classical.lines.vectorise import centre_curves as centre_curves
from classical.lines.vectorise import curves_from_both as curves_from_both
from classical.lines.vectorise import curves_from_heatmap as curves_from_heatmap
from classical.lines.vectorise import curves_from_image as curves_from_image
