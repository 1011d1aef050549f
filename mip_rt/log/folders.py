"""Where logs are."""

import tempfile
from pathlib import Path


def temporary_log_folder() -> Path:
    """Where a dry run's log goes when nobody says."""
    return Path(tempfile.gettempdir()) / "mip-rt"
