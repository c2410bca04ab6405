"""Fine-tune a vision-language model on the action tokens of a dataset, as OpenVLA does.

    python finetune_tokens.py --data dataset --model tiny -o tiny                  # minutes on a CPU, tests the steps
    python finetune_tokens.py --data dataset --model openvla/openvla-7b -o adapted   # transformers, peft, GPU

Then, from the folder of this file:  VLA_CHECKPOINT=tiny factory eval dataset --policy finetune_tokens:VlaPolicy

An action is two tokens: one of 7 grid points of v and one of 7 grid points of w. They replace the last 14 tokens of the
vocabulary of the language model (OpenVLA replaces 256), so the vocabulary does not grow. Needs the extra `train`.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
import torch
from torch import nn

from minivla import Dataset, FrameDataset

GRID = 7
PROMPT = "In: What action should the robot take to {instruction}?\nOut:"


def prompt_of(instruction):
    """Returns the prompt of OpenVLA for an instruction, in lower case and without a full stop."""
    return PROMPT.format(instruction=instruction.lower().rstrip(". "))


def to_vocabulary(tokens, vocabulary):
    """Converts tokens 0..6 to ids of the language model, counted from the end: v from -14 to -8, w from -7 to -1."""
    return vocabulary - 2 * GRID + np.asarray(tokens) + np.array((0, GRID))


def from_logits(logits, place, vocabulary):
    """Returns the most likely token 0..6 of v (`place` 0) or w (`place` 1); other tokens are ignored."""
    first = vocabulary - 2 * GRID + place * GRID
    return int(logits[first : first + GRID].argmax())


class TinyVla(nn.Module):
    """Transformer of two layers with random weights; the input is image patches, prompt bytes and the answer."""

    vocabulary, size, patch, width = 512, 64, 16, 64

    def __init__(self):
        super().__init__()
        self.see = nn.Conv2d(3, self.width, self.patch, self.patch)
        self.say = nn.Embedding(self.vocabulary, self.width)
        self.place = nn.Parameter(0.02 * torch.randn(1, 256, self.width))
        layer = nn.TransformerEncoderLayer(self.width, 4, 4 * self.width, dropout=0.0, batch_first=True)
        self.layers = nn.TransformerEncoder(layer, 2)
        self.out = nn.Linear(self.width, self.vocabulary)

    def encode(self, prompt):
        """Returns the bytes of a prompt as token ids."""
        return list(prompt.encode())

    def pixels(self, rgb):
        """Converts images (N, 640, 640, 3) uint8 to the input of the model."""
        every = rgb.shape[1] // self.size
        return rgb[:, ::every, ::every].permute(0, 3, 1, 2).float() / 127.5 - 1

    def forward(self, pixels, ids):
        """Returns the logits (N, L, vocabulary) of the token after each id."""
        seen = self.see(pixels).flatten(2).transpose(1, 2)
        x = torch.cat([seen, self.say(ids)], dim=1) + self.place[:, : seen.shape[1] + ids.shape[1]]
        mask = nn.Transformer.generate_square_subsequent_mask(x.shape[1])
        return self.out(self.layers(x, mask=mask, is_causal=True))[:, seen.shape[1] :]

    def save(self, out):
        """Writes the weights."""
        torch.save(self.state_dict(), Path(out) / "tiny.pt")

    @classmethod
    def load(cls, out):
        """Reads the weights."""
        model = cls()
        model.load_state_dict(torch.load(Path(out) / "tiny.pt", weights_only=True))
        return model


class PretrainedVla(nn.Module):
    """OpenVLA, or a model with its interface, with low-rank adapters."""

    def __init__(self, name, adapters=None):
        super().__init__()
        from peft import LoraConfig, PeftModel, get_peft_model
        from transformers import AutoModelForVision2Seq, AutoProcessor

        self.processor = AutoProcessor.from_pretrained(name, trust_remote_code=True)
        base = AutoModelForVision2Seq.from_pretrained(name, torch_dtype=torch.bfloat16, trust_remote_code=True)
        if adapters:
            self.model = PeftModel.from_pretrained(base, adapters)
        else:
            self.model = get_peft_model(base, LoraConfig(r=32, lora_alpha=16, target_modules="all-linear"))
        self.model.to("cuda")
        self.vocabulary = len(self.processor.tokenizer)

    def encode(self, prompt):
        """Returns the token ids of a prompt and the empty token 29871, which OpenVLA expects after it."""
        return [*self.processor.tokenizer(prompt)["input_ids"], 29871]

    def pixels(self, rgb):
        """Converts images (N, 640, 640, 3) uint8 with the image processor of the model."""
        from PIL import Image

        images = [Image.fromarray(picture.numpy()) for picture in rgb]
        return self.processor.image_processor(images, return_tensors="pt")["pixel_values"].to("cuda", torch.bfloat16)

    def forward(self, pixels, ids):
        """Returns the logits (N, L, vocabulary) of the token after each id, without those of the image patches."""
        ids = ids.to("cuda")
        logits = self.model(input_ids=ids, pixel_values=pixels, attention_mask=torch.ones_like(ids)).logits
        return torch.cat([logits[:, :1], logits[:, logits.shape[1] - ids.shape[1] + 1 :]], dim=1).float().cpu()

    def save(self, out):
        """Writes the adapters."""
        self.model.save_pretrained(out)


def batches(dataset, size, seed):
    """Yields prompts with samples of this prompt, so no padding is needed; never ends."""
    rng = np.random.default_rng(seed)
    while True:
        samples = dataset.__getitems__(rng.integers(0, len(dataset), size).tolist())
        by_prompt = {}
        for sample in samples:
            by_prompt.setdefault(prompt_of(sample["instruction"]), []).append(sample)
        yield from by_prompt.items()


def train(model, dataset, steps, batch, rate, seed):
    """Fits the model to the tokens and returns the losses."""
    learned = [parameter for parameter in model.parameters() if parameter.requires_grad]
    optimizer = torch.optim.AdamW(learned, lr=rate)
    losses = []
    for step, (prompt, samples) in zip(range(steps), batches(dataset, batch, seed), strict=False):
        asked = torch.tensor([model.encode(prompt)]).expand(len(samples), -1)
        wanted = torch.from_numpy(np.stack([to_vocabulary(sample["tokens"], model.vocabulary) for sample in samples]))
        pixels = model.pixels(torch.from_numpy(np.stack([sample["rgb"] for sample in samples])))
        logits = model(pixels, torch.cat([asked, wanted[:, :1]], dim=1))[:, -2:]
        loss = nn.functional.cross_entropy(logits.reshape(-1, logits.shape[-1]), wanted.reshape(-1))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
        if step % 10 == 0:
            print(f"step {step}: loss {losses[-1]:.3f}", flush=True)
    return losses


class VlaPolicy:
    """Policy of `factory eval` that loads the model from VLA_CHECKPOINT; VLA_MODEL is its name (default: `tiny`)."""

    actions = "tokens"
    hold = 6

    def __init__(self):
        checkpoint, name = os.environ["VLA_CHECKPOINT"], os.environ.get("VLA_MODEL", "tiny")
        self.model = (TinyVla.load(checkpoint) if name == "tiny" else PretrainedVla(name, checkpoint)).eval()

    def reset(self, instruction, info):  # noqa: ARG002
        """Encodes the instruction."""
        self.asked = torch.tensor([self.model.encode(prompt_of(instruction))])

    def act(self, observation):
        """Returns (6, 2) tokens: one answer of the model, repeated for six steps (0.1 s)."""
        pixels = self.model.pixels(torch.from_numpy(observation["rgb"].copy())[None])
        ids, answer = self.asked, []
        with torch.inference_mode():
            for place in (0, 1):
                token = from_logits(self.model(pixels, ids)[0, -1], place, self.model.vocabulary)
                answer.append(token)
                said = self.model.vocabulary - 2 * GRID + place * GRID + token
                ids = torch.cat([ids, torch.tensor([[said]])], dim=1)
        return np.tile(np.array(answer), (self.hold, 1))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True)
    parser.add_argument("--split", default="train_id")
    parser.add_argument("--model", default="tiny")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--rate", type=float, default=5e-4)
    parser.add_argument("--stride", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--out", required=True)
    chosen = parser.parse_args()
    torch.manual_seed(chosen.seed)
    frames = FrameDataset(Dataset(chosen.data).filter(split=chosen.split), stride=chosen.stride)
    model = TinyVla() if chosen.model == "tiny" else PretrainedVla(chosen.model)
    losses = train(model, frames, chosen.steps, chosen.batch, chosen.rate, chosen.seed)
    Path(chosen.out).mkdir(parents=True, exist_ok=True)
    model.save(chosen.out)
    print(f"first loss {losses[0]:.3f}, mean of the last ten {np.mean(losses[-10:]):.3f}; written to {chosen.out}")


if __name__ == "__main__":
    main()
