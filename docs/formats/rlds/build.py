"""Writes a dataset of minivla-factory as RLDS with TFDS.

Run in an environment with tensorflow, tensorflow-datasets and minivla-factory (Python 3.11):

    MINIVLA_DATASET=/data/office MINIVLA_FPS=10 python build.py /data/rlds
"""

from __future__ import annotations

import sys

from minivla_nav.minivla_nav_dataset_builder import MinivlaNav

if __name__ == "__main__":
    MinivlaNav(data_dir=sys.argv[1]).download_and_prepare()
