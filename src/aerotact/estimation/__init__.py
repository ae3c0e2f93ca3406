"""Model -> estimator. A module offers its estimators in a constant `ESTIMATORS`: block name -> builder."""

from aerotact.discovery import BlockMaker, collect

EstimatorBuilder = BlockMaker


def estimators() -> dict[str, EstimatorBuilder]:
    """Every estimator by its block's name."""
    return collect(__name__, "ESTIMATORS")
