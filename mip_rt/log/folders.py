"""Where logs are."""

import tempfile
from pathlib import Path


def temporary_log_folder() -> Path:
    """Where a dry run's log goes when nobody says."""
    return Path(tempfile.gettempdir()) / "mip-rt"


def usual_folders() -> list[Path]:
    """Where rings are: the configuration's folder, and that of dry runs."""
    settings = _settings()
    return [*([Path(settings.folder)] if settings else []), temporary_log_folder()]


def usual_record_folder() -> Path | None:
    """Where the recorder of this machine keeps its files; None where the configuration cannot be read."""
    settings = _settings()
    return Path(settings.record_folder) if settings else None


def _settings():
    """Section `log` of this machine's configuration; None where that is broken, which must not keep anyone from a log."""
    from mip_rt import config as configuration
    from mip_rt.errors import ConfigError

    try:
        return configuration.load(configuration.default_path("mbbr")).log
    except ConfigError:
        return None
