"""What a model says that an instrument would see, asked of the workers through the controller."""

from validation.prediction.predictor import Predictor
from validation.prediction.words import (
    POSE_COLUMNS,
    Anchored,
    Curve,
    FarView,
    Pose,
    Predicted,
    PredictedCurve,
    Sensor,
    View,
)

__all__ = [
    "POSE_COLUMNS",
    "Anchored",
    "Curve",
    "FarView",
    "Pose",
    "Predicted",
    "PredictedCurve",
    "Predictor",
    "Sensor",
    "View",
]
