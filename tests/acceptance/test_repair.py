"""`factory repair` from the command line on a copy of a real dataset."""

from __future__ import annotations

import shutil


def test_repair_restores_a_dataset_without_ledger_scene_and_tables(command, reference, tmp_path):
    root = tmp_path / "dataset"
    shutil.copytree(reference, root)
    digest = command.json("verify", reference)["digest"]
    for path in (root / "ledger.db", root / "metadata.parquet", next((root / "scenes").glob("hospital-*.zip"))):
        path.unlink()
    done = command.json("repair", root)
    assert [action["kind"] for action in done["actions"]] == ["rebuild", "restore", *["adopt"] * 5, "rewrite"]
    assert command.json("repair", root, "--dry-run")["actions"] == []
    assert command.json("verify", root, "--deep")["digest"] == digest
    assert command.json("status", root)["finished"]


def test_repair_without_ledger_and_description_requires_the_plan(command, reference, plan, tmp_path):
    root = tmp_path / "dataset"
    shutil.copytree(reference, root)
    for name in ("ledger.db", "dataset_meta.json"):
        (root / name).unlink()
    for path in sorted((root / "episodes").iterdir())[1:]:
        path.unlink()
    assert "--plan" in command("repair", root, "--dry-run", expect=2).stderr
    done = command.json("repair", root, "--plan", plan)
    assert (done["episodes"], done["planned"]) == (1, 5)


def test_a_missing_directory_is_reported(command, tmp_path):
    assert "nowhere does not exist" in command("repair", tmp_path / "nowhere", expect=2).stderr
    assert not (tmp_path / "nowhere").exists()
