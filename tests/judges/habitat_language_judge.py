"""Opens a `vlnce` export with routes with Habitat's VLN loader, and compares every text and span with the dataset.

Runs in a separate environment (Python 3.11, habitat-lab 0.3.3, pyarrow; see `make test-language`), does not import this
project, and exits with code 1 at the first failed check.

    python tests/judges/habitat_language_judge.py DATASET EXPORT

DATASET: a relabelled dataset. EXPORT: its export with `--to vlnce`.
"""

import gzip
import json
import sys
from pathlib import Path
from typing import Any

from habitat_judge import load
from said import Said, counted
from verdict import named, say


def main() -> None:
    said, export = Said(Path(sys.argv[1])), Path(sys.argv[2])
    names = []
    for folder in sorted(path.parent for path in export.glob("*/*_gt.json.gz")):
        data = load(export, folder.name)
        paths = json.loads(gzip.decompress((folder / f"{folder.name}_gt.json.gz").read_bytes()))
        for episode in data.episodes:
            names.append(episode.info["minivla_episode_id"])
            locations = paths[str(episode.episode_id)]["locations"]
            judge_episode(said, episode, data.instruction_vocab.word_list, len(locations))
    assert sorted(names) == sorted(said.first)
    say(export, named("habitat-lab"), f"{len(names)} instructions, {counted(map(said.steps, names))}")


def judge_episode(said: Said, episode: Any, words: list[str], frames: int) -> None:
    """Checks the instruction, its tokens, and the sub-instructions with their spans of the driven path."""
    name = episode.info["minivla_episode_id"]
    assert episode.instruction.instruction_text == said.first[name], name
    tokens = [words[token] for token in episode.instruction.instruction_tokens if token]
    read = "".join(tokens)
    assert read == "".join(said.first[name].lower().split()), (name, read)
    steps = said.steps(name)
    assert episode.info.get("sub_instructions", []) == steps, name
    if steps:
        assert [each["start"] for each in steps] == [0, *(each["end"] for each in steps[:-1])]
        assert steps[-1]["end"] == frames


if __name__ == "__main__":
    main()
