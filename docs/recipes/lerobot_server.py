"""Serves a policy of LeRobot (ACT, SmolVLA, ...) to `factory eval`. Needs lerobot, msgpack and websockets only.

python lerobot_server.py CHECKPOINT --fps 10      then:  factory eval DIR --policy act=ws://127.0.0.1:8401

CHECKPOINT is a folder `pretrained_model` of `lerobot-train`, or a repository of the Hub; --fps is that of the export.
"""

import argparse
import copy
import hashlib
import threading
from pathlib import Path

import msgpack
import numpy as np
import torch
from lerobot.common.control_utils import predict_action
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from PIL import Image
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve

ONE_CAMERA = ("act", "diffusion", "vqbet", "tdmpc")
CONTROL_HZ = 60
"""Rate of the observations of `factory eval`; with a plan of another `control_hz`, give --control-hz."""


def pack(array):
    return {b"__ndarray__": True, b"data": array.tobytes(), b"dtype": array.dtype.str, b"shape": array.shape}


def unpack(found):
    if b"__ndarray__" in found:
        return np.frombuffer(found[b"data"], np.dtype(found[b"dtype"])).reshape(found[b"shape"])
    return found


class Server:
    """A loaded policy. Each connection has a copy that shares the weights, because policies keep a queue of actions."""

    def __init__(self, checkpoint, device, held):
        self.config = PreTrainedConfig.from_pretrained(checkpoint)
        self.config.device = device
        self.policy = get_policy_class(self.config.type).from_pretrained(checkpoint, config=self.config).eval()
        overrides = {"device_processor": {"device": device}}
        self.processors = make_pre_post_processors(self.config, checkpoint, preprocessor_overrides=overrides)
        self.device, self.held, self.lock = torch.device(device), held, threading.Lock()
        # a VLA such as SmolVLA has several cameras and drives with the first one alone; ACT needs each of its images
        names = sorted(self.config.image_features)
        if not names or (len(names) > 1 and self.config.type in ONE_CAMERA):
            raise SystemExit(f"{checkpoint} needs the images {names}; this server has one, the front camera")
        self.image, self.size = names[0], self.config.image_features[names[0]].shape[:0:-1]
        weights = Path(checkpoint) / "model.safetensors"
        digest = hashlib.sha256(weights.read_bytes()).hexdigest() if weights.is_file() else ""
        self.greeting = {"name": self.config.type, "checkpoint": str(checkpoint), "sha256": digest}

    def handle(self, connection):
        policy = copy.copy(self.policy)
        connection.send(msgpack.packb(self.greeting))
        try:
            for message in connection:
                request = msgpack.unpackb(message, object_hook=unpack, strict_map_key=False)
                if request["step"] == 0:
                    policy.reset()
                connection.send(msgpack.packb({"actions": self.act(policy, request)}, default=pack))
        except ConnectionClosed:
            pass  # the end of the evaluation

    def act(self, policy, request):
        image = Image.fromarray(request["rgb"]).resize(self.size, Image.Resampling.BOX)
        observation = {self.image: np.array(image)}
        if self.config.robot_state_feature is not None:
            observation["observation.state"] = np.array(request["state"])
        with self.lock:
            before, after = self.processors
            action = predict_action(
                observation,
                policy,
                self.device,
                preprocessor=before,
                postprocessor=after,
                use_amp=False,
                task=request["prompt"],
            )
        # an action of the export is the mean of the commands until its next frame, so it is held until then
        return np.tile(action.squeeze(0).cpu().numpy()[:2].astype(np.float32), (self.held, 1))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkpoint")
    parser.add_argument("--fps", type=int, required=True, help="rate of the exported dataset, 1/s")
    parser.add_argument("--control-hz", type=int, default=CONTROL_HZ)
    parser.add_argument("--port", type=int, default=8401)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    arguments = parser.parse_args()
    if arguments.fps < 1 or arguments.control_hz % arguments.fps:
        parser.error(f"--fps must divide the control rate of {arguments.control_hz} Hz")
    server = Server(arguments.checkpoint, arguments.device, arguments.control_hz // arguments.fps)
    with serve(server.handle, "127.0.0.1", arguments.port, compression=None, max_size=None) as listening:
        print(f"serving ws://127.0.0.1:{listening.socket.getsockname()[1]}", flush=True)
        listening.serve_forever()
