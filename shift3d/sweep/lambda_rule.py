"""Which lambda a vehicle's shape results are reported with."""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["NEARLY_EQUAL_ABSOLUTE", "NEARLY_EQUAL_RELATIVE", "select_lambda"]

# Our choice: the paper says 'very similar' and no number.
NEARLY_EQUAL_RELATIVE = 0.05
NEARLY_EQUAL_ABSOLUTE = 0.01


def select_lambda(mean_loss: Mapping[float, float]) -> float:
    """The lambda with the lowest mean adversarial loss, or a larger one whose loss is nearly equal to it.

    Args:
        mean_loss: lambda to the mean of L_adv over the scenes that were scored under every lambda.

    Raises:
        ValueError: no lambda.

    Source: SHIFT3D section Hyper-parameters ('in cases where different settings of λ produce very similar
    loss values, we will choose the larger λ'). Nearly equal: within 5 % of the lowest, or 0.01, whichever
    is more.
    """
    if not mean_loss:
        raise ValueError("no lambda to choose from")
    lowest = min(mean_loss.values())
    margin = max(NEARLY_EQUAL_ABSOLUTE, NEARLY_EQUAL_RELATIVE * abs(lowest))
    return max(value for value, loss in mean_loss.items() if loss <= lowest + margin)
