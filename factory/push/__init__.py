"""Uploads a dataset or an export to the Hugging Face Hub: selects files, splits them into commits, sets the tag."""

from __future__ import annotations

from factory.push.files import PushPlan, plan_push
from factory.push.hub import PushResult, push

__all__ = ["PushPlan", "PushResult", "plan_push", "push"]
