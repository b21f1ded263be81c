"""What a command has written."""

from pathlib import Path


def file_contents(folder: Path) -> dict[str, bytes]:
    """Bytes of every file below a folder, by its path from there."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
