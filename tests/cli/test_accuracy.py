"""``--accuracy``, and ``accuracy`` in Python: the systematic errors of the poses."""

import csv
import json
from pathlib import Path

import pytest

import contact_tracker
from contact_tracker.cli.main import run
from contact_tracker.errors import UsageError
from contact_tracker.trajectory.arguments import model_from

PAPER = str(Path(__file__).resolve().parents[2] / "recordings" / "paper_experiment.mcap")


def deviation_of_the_table(out):
    """Deviation of the first normal (rad)."""
    with open(out, encoding="utf-8", newline="") as file:
        row = next(csv.DictReader(file))
    return max(json.loads(row["geometry"])["environment"]["plane"]["normal_sd"])


def test_it_increases_the_deviations_of_elements(tmp_path, capsys):
    out, command = tmp_path / "segments.csv", ["segment", "-q", PAPER, "--duration", "10", "--overwrite"]
    assert run([*command, "-o", str(out)]) == 0
    noise = deviation_of_the_table(out)
    assert run([*command, "-o", str(out), "--accuracy", "0.5mm,0.1deg"]) == 0
    assert deviation_of_the_table(out) > 3.0 * noise
    assert run([*command, "--accuracy", "0.5"]) == 2
    assert "0.3mm,0.15deg" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--accuracy", "--noise"])
@pytest.mark.parametrize("value", ["0.11m,0.1deg", "0.5mm,0.2rad"])
def test_errors_that_leave_no_contact_are_refused_as_another_unit(option, value, capsys):
    assert run(["segment", "-q", PAPER, option, value]) == 2
    assert "at most 100 mm and 10 deg, at least 1e-9 m and rad. Are the units right?" in (
        capsys.readouterr().err
    )
    with pytest.raises(UsageError, match="at most 100 mm and 10 deg"):
        model_from("default", **{option.lstrip("-"): value})
    with pytest.raises(UsageError, match="at most 100 mm and 10 deg"):
        model_from("default", **{option.lstrip("-"): (0.5, 1e-3)})
    assert model_from("default", accuracy="100mm,10deg").systematic.position_m == 0.1


def test_python_takes_it_as_it_takes_the_noise():
    assert model_from("default", accuracy="0.5mm,1mrad").systematic.position_m == 0.5e-3
    assert model_from("default", accuracy="0.5mm,0deg").systematic.rotation_rad == 0.0
    assert model_from("default", accuracy=(1e-3, 2e-3)).systematic.rotation_rad == 2e-3
    with pytest.raises(UsageError, match="accuracy"):
        contact_tracker.Tracker(accuracy="0.5mm")
