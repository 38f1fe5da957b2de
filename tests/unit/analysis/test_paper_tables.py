"""The paper's numbers are the paper's."""

from __future__ import annotations

import pytest

from shift3d.analysis.tables.paper import paper_table


@pytest.mark.parametrize(
    ("which", "method", "name", "values"),
    [
        (("shape", "pointpillars", "pointpillars"), "baseline", "tab:auc_z", (0.755, 0.756, 0.755, 0.681, 0.779)),
        (("shape", "pointpillars", "pointpillars"), "random", "tab:auc_z", (0.716, 0.721, 0.728, 0.625, 0.746)),
        (("shape", "pointpillars", "pointpillars"), "adversarial_noise", "tab:auc_z",
         (0.469, 0.451, 0.473, 0.392, 0.519)),
        (("shape", "pointpillars", "pointpillars"), "adversarial", "tab:auc_z", (0.466, 0.448, 0.469, 0.390, 0.514)),
        (("pose", "pointpillars", "pointpillars"), "baseline", "tab:auc_theta", (0.755, 0.756, 0.755, 0.681, 0.779)),
        (("pose", "pointpillars", "pointpillars"), "random", "tab:auc_theta", (0.683, 0.705, 0.719, 0.611, 0.713)),
        (("pose", "pointpillars", "pointpillars"), "adversarial", "tab:auc_theta",
         (0.580, 0.574, 0.571, 0.489, 0.648)),
        (("shape", "sst", "sst"), "baseline", "tab:sst_auc_z", (0.812, 0.817, 0.743, 0.726, 0.830)),
        (("shape", "sst", "sst"), "adversarial", "tab:sst_auc_z", (0.533, 0.524, 0.471, 0.448, 0.585)),
        (("shape", "sst", "pointpillars"), "adversarial", "tab:sst_auc_z", (0.559, 0.538, 0.581, 0.461, 0.623)),
        (("pose", "sst", "sst"), "adversarial", "tab:sst_auc_theta", (0.681, 0.678, 0.518, 0.544, 0.740)),
        (("pose", "sst", "pointpillars"), "adversarial", "tab:sst_auc_theta", (0.691, 0.695, 0.659, 0.601, 0.739)),
    ],
)  # fmt: skip
def test_the_papers_numbers_are_the_papers(
    which: tuple[str, str, str], method: str, name: str, values: tuple[float, ...]
) -> None:
    found = paper_table(*which)
    assert found is not None and found.name == name
    assert tuple(found.aucs.by_method[method].values()) == values
    assert tuple(found.aucs.by_method[method]) == ("coupe", "sports_car", "suv", "convertible", "beach_wagon")
