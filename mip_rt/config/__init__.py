"""Configuration: one schema that validates, documents and templates the YAML."""

from mip_rt.config.loading import Config, default_path, load, loads, parse_override  # noqa: F401
