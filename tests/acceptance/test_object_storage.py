"""A run with a dataset in a bucket, from the command line."""

from __future__ import annotations

import json

import pytest

from tests.acceptance.factory_cli import Command, FactoryCli


@pytest.mark.slow
def test_a_run_into_a_bucket_is_made_resumed_verified_and_reported(plan, cache, object_store, tmp_path):
    state = tmp_path / "state"
    variables = {**object_store.variables(), "MINIVLA_STATE": str(state)}
    factory, command = FactoryCli(tmp_path, cache, variables), Command(cache, variables)
    url = f"s3://{object_store.new_bucket()}/tiny"
    small = ("--scene", "hospital", "--episodes", 1)
    try:
        made = json.loads(factory("run", plan, "--out", url, "--workers", 1, *small, "--json").stdout)
        assert (made["dataset"], made["episodes"], made["failed"]) == (url, 1, 0)
        resumed = factory.json("run", "--out", url, "--workers", 1)
        assert resumed["digest"] == made["digest"]
        checked = command.json("verify", url, "--deep")
        assert (checked["ok"], checked["complete"], checked["digest"]) == (True, True, made["digest"])
        assert command.json("status", url)["finished"]
        read = factory.json("bench", "read", url, "--frames", 4, "--repeats", 1, "--workers", 0)
        assert (read["episodes"], read["frames"]) == (1, 4)
        assert f"supports dataset directories only, not {url}" in command("push", url, "me/tiny", expect=2).stderr
        assert "supports dataset directories only, not" in command("eval", url, expect=2).stderr
    finally:
        factory.end()
    (home,) = (state / "archives").iterdir()
    assert (home / "ledger.db").is_file()
    assert not (home / "episodes").exists()
