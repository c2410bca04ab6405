"""Writes a checkpoint of SmolVLA with random weights of the true shapes. Runs in LeRobot's environment.

python smolvla_checkpoint.py EXPORT OUT

The sizes are those of HuggingFaceTB/SmolVLM2-500M-Video-Instruct, of which SmolVLA keeps 16 layers of text. No weights
and no tokenizer are downloaded: a word-level tokenizer of the same interface is written beside the checkpoint.
"""

from __future__ import annotations

import sys
from pathlib import Path

import tokenizers
import torch
import transformers
from lerobot.datasets.lerobot_dataset import LeRobotDatasetMetadata
from lerobot.policies.factory import make_pre_post_processors
from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig
from lerobot.policies.smolvla.modeling_smolvla import SmolVLAPolicy
from lerobot.utils.feature_utils import dataset_to_policy_features

_SPECIAL = ("<unk>", "<pad>", "<end_of_utterance>", "<fake_token_around_image>", "<image>", "<global-img>")


def write_backbone(folder: Path) -> None:
    """Writes configuration and processor of the vision-language model, without weights."""
    text = transformers.LlamaConfig(
        hidden_size=960,
        intermediate_size=2560,
        num_hidden_layers=32,
        num_attention_heads=15,
        num_key_value_heads=5,
        head_dim=64,
        vocab_size=49280,
        pad_token_id=1,
    )
    vision = {
        "hidden_size": 768,
        "intermediate_size": 3072,
        "num_hidden_layers": 12,
        "num_attention_heads": 12,
        "image_size": 512,
        "patch_size": 16,
    }
    config = transformers.SmolVLMConfig(
        text_config=text.to_dict(), vision_config=vision, image_token_id=4, pad_token_id=1, scale_factor=4
    )
    config.save_pretrained(folder)
    model = tokenizers.Tokenizer(
        tokenizers.models.WordLevel({word: n for n, word in enumerate(_SPECIAL)}, unk_token="<unk>")
    )
    model.pre_tokenizer = tokenizers.pre_tokenizers.Whitespace()
    words = transformers.PreTrainedTokenizerFast(
        tokenizer_object=model,
        unk_token="<unk>",
        pad_token="<pad>",
        eos_token="<end_of_utterance>",
        extra_special_tokens={
            "fake_image_token": "<fake_token_around_image>",
            "image_token": "<image>",
            "global_image_token": "<global-img>",
            "end_of_utterance_token": "<end_of_utterance>",
        },
    )
    pictures = transformers.SmolVLMImageProcessor()
    movies = transformers.SmolVLMVideoProcessor()
    transformers.SmolVLMProcessor(pictures, words, movies).save_pretrained(folder)


def main() -> None:
    export, out = Path(sys.argv[1]), Path(sys.argv[2])
    backbone = out / "backbone"
    write_backbone(backbone)
    torch.manual_seed(1)
    meta = LeRobotDatasetMetadata("local/nav", root=export)
    features = dataset_to_policy_features(meta.features)
    config = SmolVLAConfig(vlm_model_name=str(backbone), device="cpu", push_to_hub=False)
    config.input_features = {name: feature for name, feature in features.items() if name.startswith("observation.")}
    config.output_features = {"action": features["action"]}
    policy = SmolVLAPolicy(config)
    policy.save_pretrained(out)
    for processor in make_pre_post_processors(config, dataset_stats=meta.stats):
        processor.save_pretrained(out)
    millions = sum(weight.numel() for weight in policy.parameters()) / 1e6
    sys.stdout.write(f"smolvla: {millions:.0f} M parameters, inputs {sorted(config.input_features)}\n")


if __name__ == "__main__":
    main()
