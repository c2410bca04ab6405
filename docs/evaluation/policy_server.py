"""A policy behind a websocket, with the protocol of openpi. Needs numpy, msgpack and websockets, but not this project.

python policy_server.py 8000            then:  factory eval DIR --policy ws://127.0.0.1:8000
"""

import sys

import msgpack
import numpy as np
from websockets.sync.server import serve


def pack(array):
    return {b"__ndarray__": True, b"data": array.tobytes(), b"dtype": array.dtype.str, b"shape": array.shape}


def unpack(found):
    if b"__ndarray__" in found:
        return np.frombuffer(found[b"data"], np.dtype(found[b"dtype"])).reshape(found[b"shape"])
    return found


def infer(observation):
    """Put your model here. The observation has `rgb`, `depth`, `prompt` and `step`, which is 0 at the first frame."""
    ahead = np.percentile(observation["depth"][200:400, 220:420], 5)
    action = (0.5, 0.0) if ahead > 0.8 else (0.0, 0.8)
    return {"actions": np.tile(np.float32(action), (6, 1))}  # a chunk: six steps of 1/60 s


def handle(connection):
    connection.send(msgpack.packb({"name": "example"}))
    for message in connection:
        observation = msgpack.unpackb(message, object_hook=unpack, strict_map_key=False)
        connection.send(msgpack.packb(infer(observation), default=pack))


if __name__ == "__main__":
    with serve(handle, "127.0.0.1", int(sys.argv[1]), compression=None, max_size=None) as server:
        print(f"serving ws://127.0.0.1:{server.socket.getsockname()[1]}", flush=True)
        server.serve_forever()
