"""MCAP files with messages of ROS 2, JSON or protobuf."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from skat.logs.errors import LogError
from skat.logs.readers.messages import LARGEST_MESSAGE, Message, messages_recording
from skat.logs.streams import Recording, required


def read(path: Path) -> Recording:
    """Return the recording of an MCAP file; one without an index is read from its beginning.

    Raises
    ------
    LogError
        If it is cut or damaged, or no topic holds numbers.
    """
    required("mcap.reader", "An MCAP file")
    types: dict[str, str] = {}
    try:
        summary = _summary(path)
    except Exception as error:
        raise _damaged(path, error) from None
    if summary is not None:
        for channel in summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            types[channel.topic] = schema.name if schema else channel.message_encoding
    return messages_recording(str(path), types, lambda topics: _messages(path, topics))


def _summary(path: Path) -> Any:
    from mcap.reader import make_reader

    with path.open("rb") as file:
        return make_reader(file).get_summary()


def _messages(path: Path, topics: set[str] | None) -> Iterator[Message]:
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    factories = _factories()
    decoders: dict[int, Any] = {}
    with path.open("rb") as file:
        try:
            messages = make_reader(file).iter_messages(topics=None if topics is None else list(topics))
        except Exception as error:
            raise _damaged(path, error) from None
        while True:
            try:
                schema, channel, message = next(messages)
            except StopIteration:
                return
            except Exception as error:
                raise _damaged(path, error) from None
            if len(message.data) > LARGEST_MESSAGE:
                continue
            try:
                if channel.id not in decoders:
                    decoders[channel.id] = _decoder(factories, channel, schema)
                decode = decoders[channel.id]
                if decode is None:
                    continue
                decoded = decode(message.data)
            except McapError as error:
                raise _damaged(path, error, channel.topic) from None
            except Exception as error:
                raise _damaged(path, error, channel.topic) from None
            yield channel.topic, message.log_time, decoded


def _factories() -> list[Any]:
    ros2 = required("mcap_ros2.decoder", "An MCAP file of ROS 2")
    protobuf = required("mcap_protobuf.decoder", "An MCAP file of protobuf")
    return [ros2.DecoderFactory(), protobuf.DecoderFactory()]


def _decoder(factories: list[Any], channel: Any, schema: Any) -> Callable[[bytes], Any] | None:
    if channel.message_encoding == "json":
        return _json
    for factory in factories:
        decoder: Callable[[bytes], Any] | None = factory.decoder_for(channel.message_encoding, schema)
        if decoder is not None:
            return decoder
    return None


def _json(data: bytes) -> dict[str, Any]:
    value = json.loads(data)
    return value if isinstance(value, dict) else {"data": value}


def _damaged(path: Path, error: Exception, topic: str = "") -> LogError:
    told = " ".join(str(error).split())[:200] or type(error).__name__
    return LogError(
        f"{path}, {topic}" if topic else str(path),
        f"is cut or damaged: {told}.",
        "Copy the file anew; of a recording that was cut off, 'mcap recover' saves what is there.",
    )
