"""rosbag2 (SQLite and MCAP storage, with or without metadata.yaml) and ROS 1 bags, by rosbags."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from skat.logs.errors import LogError
from skat.logs.readers.messages import LARGEST_MESSAGE, Message, messages_recording
from skat.logs.streams import Recording, required

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys.store import Typestore


def read(path: Path) -> Recording:
    """Return the recording of a bag.

    Raises
    ------
    LogError
        If it is cut or damaged, or no topic holds numbers.
    """
    required("rosbags.highlevel", "A ROS bag")
    paths = _files(path)
    with _opened(paths, path) as reader:
        types = {connection.topic: connection.msgtype for connection in reader.connections}
    return messages_recording(str(path), types, lambda topics: _messages(paths, path, topics))


def _files(path: Path) -> list[Path]:
    """Return what rosbags is to open: a folder with its description, or the files in it."""
    if path.is_file() or (path / "metadata.yaml").is_file():
        return [path]
    return sorted(path.glob("*.db3")) or sorted(path.glob("*.mcap"))


def _messages(paths: list[Path], path: Path, topics: set[str] | None) -> Iterator[Message]:
    """Yield (topic, stamp, message) of the topics; types that no definition is known of are passed over."""
    with _opened(paths, path) as reader:
        chosen = [one for one in reader.connections if topics is None or one.topic in topics]
        unknown: set[str] = set()
        messages = reader.messages(chosen) if chosen else iter(())
        while True:
            try:
                connection, stamp, data = next(messages)
            except StopIteration:
                return
            except Exception as error:
                raise _damaged(path, error) from None
            if data is None:
                raise _damaged(path, "a message without content", connection.topic)
            if len(data) > LARGEST_MESSAGE or connection.msgtype in unknown:
                continue
            try:
                message = reader.deserialize(data, connection.msgtype)
            except KeyError:
                unknown.add(connection.msgtype)
                continue
            except Exception as error:
                raise _damaged(path, error, connection.topic) from None
            yield connection.topic, stamp, message


@cache
def _usual_types() -> "Typestore":
    """Return the types of messages in bags that hold no definitions, as older ones do."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


class _opened:
    """rosbags' reader, whose errors are those of a log."""

    def __init__(self, paths: list[Path], path: Path) -> None:
        self.paths, self.path = paths, path

    def __enter__(self) -> "AnyReader":
        from rosbags.highlevel import AnyReader

        try:
            self.reader = AnyReader(self.paths, default_typestore=_usual_types())
            self.reader.open()
        except Exception as error:
            raise _damaged(self.path, error) from None
        return self.reader

    def __exit__(self, *exception: object) -> None:
        self.reader.close()


def _damaged(path: Path, error: Exception | str, topic: str = "") -> LogError:
    told = " ".join(str(error).split())[:200] or type(error).__name__
    return LogError(
        f"{path}, {topic}" if topic else str(path),
        f"is cut or damaged, or no bag: {told}.",
        "Copy the bag anew; of a recording that was cut off, 'ros2 bag reindex' or 'mcap recover' saves what is there.",
    )
