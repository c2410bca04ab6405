"""Reads the shards with the webdataset package and compares them with the paper's tree of the same dataset.

Does not import this project. Exits with code 1 at the first failed check.

    python tests/readers/webdataset_reader.py PAPER EXPORT

PAPER: the dataset as `factory export --to paper`. EXPORT: the same episodes as `factory export --to webdataset`.
"""

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import webdataset
from paper_tree import Paper
from result import named, print_row


def main() -> None:
    paper, export = Paper(Path(sys.argv[1])), Path(sys.argv[2])
    shards = sorted(export.glob("*.tar"))
    seen: Counter[str] = Counter()
    for sample in webdataset.WebDataset([str(shard) for shard in shards], shardshuffle=False).decode("rgb8"):
        seen[check_sample(paper, sample)] += 1
    expected = {path.name: len(paper.array(path.name, "poses")) for path in paper.episodes.iterdir()}
    assert seen == expected, f"samples by episode {dict(seen)}, expected {expected}"
    print_row(export, named("webdataset"), f"{seen.total()} samples of {len(shards)} shards equal to the paper's tree")


def check_sample(paper: Paper, sample: dict) -> str:
    """Compares a complete sample; returns the id of its episode."""
    about = sample["json"]
    name, t, meta = about["episode_id"], about["step"], paper.meta(about["episode_id"])
    assert sample["__key__"].endswith(f"{name}_{t:06d}")
    assert Path(sample["__url__"]).name.startswith(f"{meta['job']['split']}-")
    assert about["instruction"] == meta["job"]["instruction"]
    np.testing.assert_array_equal(sample["rgb.png"], paper.rgb(name, t))
    np.testing.assert_array_equal(sample["depth.npy.gz"], paper.depth(name, t))
    np.testing.assert_array_equal(sample["seg.npy.gz"], paper.ids(name, t))
    values = sample["action.json"]
    np.testing.assert_array_equal(
        np.array((values["v_mps"], values["w_rps"]), np.float32), paper.array(name, "actions_continuous")[t]
    )
    assert [values["v_token"], values["w_token"]] == paper.array(name, "actions_tokens")[t].tolist()
    return str(name)


if __name__ == "__main__":
    main()
