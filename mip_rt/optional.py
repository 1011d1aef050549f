"""Packages that only some verbs need: imported where they are used, with a named error and a cure where they are missing."""

import importlib

from mip_rt.errors import MipRtError


class PackageMissing(MipRtError):
    """A verb needs a package that is not installed."""

    code = "package_missing"


def load(module: str, extra: str, purpose: str):
    """The imported module.

    Args:
        module: name to import, such as "matplotlib.pyplot".
        extra: the extra of mip-rt that brings it.
        purpose: what needs it, as the subject of a sentence.

    Raises:
        PackageMissing: it cannot be imported.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise PackageMissing(f"{purpose} needs the Python package {package} ({error}).", f'pip install "mip-rt[{extra}]"') from error
