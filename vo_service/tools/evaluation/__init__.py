"""How good a trajectory is: ATE, RPE, coverage, pictures."""

from vo_service.tools.evaluation.report import Evaluation, evaluate

__all__ = ["Evaluation", "evaluate"]
