"""Rules for running code and trusting files.

Code is run only where the user allows it: by a rig or effect file named on the command line or in
the environment, or in the user's settings (`cli/settings_files.py`). Everything else that is
read is data. Files that pamid itself loads machine code from, its compile cache, count only where
nobody else can have written them.
"""

from __future__ import annotations

import grp
import os
import pwd
import stat
from pathlib import Path

#: endings of model files that a rig can be made of (`pamid.model.registry.model_readers`). The
#: binary of an FMU is run; like code all of them are opened only where the user names them
MODEL_ENDINGS = (".xml", ".mjcf", ".urdf", ".xacro", ".fmu")


def is_code(name: str) -> bool:
    """Does this word name a Python or model file, rather than a rig or effect of the catalogue?"""
    return name.endswith((".py", *MODEL_ENDINGS)) or "/" in name or os.sep in name


def why_shared(path: Path) -> str:
    """Why somebody else may have written this file, or put another in its place; "" where only the
    user and root can.

    Looked at: who owns the file and its folder, who may write them, and who may write the folders
    above (a sticky folder, as /tmp, protects what lies in its subfolders, yet not what lies in
    itself). A symbolic link counts with what it leads to.
    """
    try:
        for place in dict.fromkeys((path.absolute(), path.resolve())):
            for near in (place, place.parent):
                if _is_anothers(status := near.lstat()):
                    return f"{near} belongs to another user ({status.st_uid})"
            for depth, folder in enumerate((place, *place.parents)):
                status = folder.lstat()
                sticky = depth > 1 and bool(status.st_mode & stat.S_ISVTX)
                if others_may_write(status) and not sticky:
                    return f"others may write {folder}"
    except OSError as error:
        return f"{error.filename or path} cannot be inspected: {error.strerror}"
    return ""


def is_users_file(path: Path) -> bool:
    """Does what the path leads to belong to the user, not merely to root?"""
    return path.stat().st_uid == os.geteuid()


def within_home(path: Path) -> bool:
    """Does it lie in the user's home folder? A home that is / or not known holds nothing."""
    try:
        home = Path.home().resolve()
    except (RuntimeError, OSError):
        return False
    return home != Path(home.anchor) and path.resolve().is_relative_to(home)


def is_shared(status: os.stat_result) -> bool:
    """Of a file or folder by itself: does it belong to somebody else than the user or root, or may
    others write it?"""
    return _is_anothers(status) or others_may_write(status)


def _is_anothers(status: os.stat_result) -> bool:
    return status.st_uid not in (0, os.geteuid())


def others_may_write(status: os.stat_result) -> bool:
    """By the mode: everybody, or a group that holds more than the user (or root)."""
    if stat.S_ISLNK(status.st_mode):  # has no mode
        return False
    return (
        bool(status.st_mode & stat.S_IWOTH)
        or bool(status.st_mode & stat.S_IWGRP)
        and not _private_group(status.st_gid)
    )


def _private_group(gid: int) -> bool:
    """Root's, or the single-user group that many systems give to every user, writable by default
    there."""
    if gid == 0:
        return True
    try:
        user, group = pwd.getpwuid(os.geteuid()), grp.getgrgid(gid)
    except KeyError:
        return False
    return (
        group.gr_name == user.pw_name and gid == user.pw_gid and set(group.gr_mem) <= {user.pw_name}
    )
