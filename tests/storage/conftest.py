"""Fixtures of the storage tests."""

import os

import pytest


@pytest.fixture(autouse=True)
def _without_fsync(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip fsync, which takes most of the time and has no visible effect without a power cut."""
    monkeypatch.setattr(os, "fsync", lambda _: None)
