"""`factory report` from the command line."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys

from schemas.support.extras import install_command


def test_a_report_is_written_and_rewritten(command, reference, tmp_path):
    found = command.json("report", reference, "-o", tmp_path / "out")
    assert (found["episodes"], found["complete"], found["remarks"]) == (5, True, [])
    assert all((tmp_path / "out" / name).stat().st_size > 0 for name in found["files"])
    assert found["page"] == str(tmp_path / "out" / "report.html")
    assert json.loads((tmp_path / "out" / "report.json").read_text())["files"] == found["files"]
    assert found["comparisons"] == []  # the plan differs from the paper's plan
    found = command.json("report", reference, "-o", tmp_path / "out", "--compare-paper")
    said = {row["what"]: row for row in found["comparisons"]}
    assert said["TL mean, all"]["published"] == 2.74
    assert said["TL mean, all"]["reason"]


def test_damage_sets_the_exit_code_and_a_nonempty_folder_is_refused(command, reference, tmp_path):
    damaged = tmp_path / "damaged"
    shutil.copytree(reference, damaged)
    bundle = damaged / "episodes" / "ep_000001.zip"
    bundle.write_bytes(bytes(bundle.stat().st_size))
    done = command("report", damaged, "-o", tmp_path / "out", expect=1)
    assert "report.html: 5 of 5 episodes" in done.stdout
    assert "damage: episodes/ep_000001.zip: skipped in trajectories" in done.stderr
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("mine")
    refused = command("report", reference, "-o", tmp_path / "mine", expect=2).stderr
    assert "--force" in refused
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["letter.txt"]


def test_a_report_without_matplotlib_is_refused_with_the_install_command(reference, tmp_path):
    code = "import sys; sys.modules['matplotlib'] = None; from factory.cli.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "report", str(reference), "-o", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert install_command("report") in done.stderr
    assert not (tmp_path / "out").exists()
