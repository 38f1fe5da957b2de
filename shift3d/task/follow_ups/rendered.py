"""Re-rendering of a row of ``solutions.parquet`` in its own scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from shift3d.attack.problem import AttackProblem
from shift3d.render.rendering import Rendering
from shift3d.store.schemas import POSE_COLUMNS
from shift3d.task.assets import Assets
from shift3d.task.problem import build_problem
from shift3d.task.spec import TaskSpec


@dataclass(frozen=True)
class RenderedSolution:
    """A solution with its rendering. code: (d,), dtype of the renderer. theta: (6,) float64."""

    problem: AttackProblem
    code: Tensor
    theta: Tensor
    rendering: Rendering


def render_solution(spec: TaskSpec, solution: Mapping[str, Any], assets: Assets) -> RenderedSolution:
    """Render a solution from scratch and without a gradient: the same points as in its task.

    solution: latent_code (d,) and the six columns of its pose. assets: those of the task's run.
    Raises: InputError for a scene or vehicle that cannot be loaded, or that differs from the plan.
    """
    theta = torch.tensor([solution[name] for name in POSE_COLUMNS], dtype=torch.float64)
    drawn = assets.rendered_vehicle(spec, solution)
    problem = build_problem(spec, assets, theta, None if drawn.name == spec.vehicle else drawn)
    code = torch.tensor(np.asarray(solution["latent_code"], dtype=np.float32)).to(problem.settings.dtype)
    with torch.no_grad():
        rendering = problem.insert(code, theta)
    return RenderedSolution(problem, code, theta, rendering)
