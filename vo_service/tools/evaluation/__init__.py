"""Accuracy of trajectories: ATE, RPE, coverage and figures."""

from vo_service.tools.evaluation.report import Evaluation, evaluate

__all__ = ["Evaluation", "evaluate"]
