"""The verb `mip-rt dmp`: gets the DMP image out of what the user holds, and checks the one that is stored."""

import sys
from pathlib import Path

from mip_rt import config as configuration
from mip_rt.errors import DmpImageError, MipRtError
from mip_rt.hardware import dmp


def add_arguments(parser) -> None:
    """Declares the verb's arguments."""
    parser.add_argument("action", choices=("extract", "verify"), help="find the image and store it; check the stored one")
    parser.add_argument("paths", metavar="PATH", nargs="*", type=Path,
                        help="extract: librobotcontrol's or MotionDriver's sources (folder, file, zip, tar) or librobotcontrol.so")  # fmt: skip
    parser.add_argument("--config", metavar="FILE", help="configuration file (default: the installed or shipped one)")
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], help="change one value, for example imu.dmp_image=FILE")


def run(arguments) -> int:
    """Exit code 0; refusals are MipRtErrors."""
    path = arguments.config or configuration.default_path("mbbr")
    imu = configuration.load(path, dict(configuration.parse_override(text) for text in arguments.set)).imu
    if arguments.action == "extract":
        _extract(arguments.paths, imu)
    dmp.load_image(imu.dmp_image, imu.dmp_image_sha256)
    print(f"{imu.dmp_image}: the DMP image, {dmp.r.DMP_IMAGE_BYTES} bytes, SHA-256 {imu.dmp_image_sha256[:16]}..., is in order")
    return 0


def _extract(paths, imu) -> None:
    from mip_rt.atomic_file import replace_file
    from mip_rt.hardware.dmp_image import identity, search

    if not paths:
        raise MipRtError("nothing to search.", "Name a folder, file or archive: mip-rt dmp extract librobotcontrol/", "arguments")
    watch = (lambda name: print(f"\x1b[K{name[-70:]}", end="\r", file=sys.stderr)) if sys.stderr.isatty() else None
    try:
        image, where = search(paths, identity(imu.dmp_image_sha256), watch)
    except OSError as error:
        raise DmpImageError(f"{error.filename} cannot be read: {error.strerror}.", "Correct the path.", "dmp_source") from error
    if image is None:
        remarks = f" But {'; '.join(where)}." if where else ""
        raise DmpImageError(f"the DMP image is not in {', '.join(map(str, paths))}.{remarks}", dmp.CURE, "dmp_image_not_found")
    target = Path(imu.dmp_image)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        replace_file(target, image)
    except OSError as error:
        raise DmpImageError(f"{target} cannot be written: {error.strerror}.", "Run it with sudo, or name another file in imu.dmp_image.", "dmp_image_write") from error
    print(f"found in {where}")
