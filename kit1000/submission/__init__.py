"""Submissions: one folder per method, with manifest.toml and predictions.csv; reading, writing and checking them."""

from __future__ import annotations

from kit1000.submission.check import check
from kit1000.submission.faults import Fault, Report
from kit1000.submission.folder import Submission, read_submission, read_valid_submission, write_submission
from kit1000.submission.manifest import Manifest, read_manifest, write_manifest
from kit1000.submission.predictions import HEADER, Predictions, read_predictions, write_predictions

__all__ = [
    "HEADER",
    "Fault",
    "Manifest",
    "Predictions",
    "Report",
    "Submission",
    "check",
    "read_manifest",
    "read_predictions",
    "read_submission",
    "read_valid_submission",
    "write_manifest",
    "write_predictions",
    "write_submission",
]
