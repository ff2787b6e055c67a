"""The smallest parts of a WebAssembly module: integers in LEB128, names, types, sections."""

from __future__ import annotations

F64, I32 = 0x7C, 0x7F  # the types of numbers and of conditions


def signed(value: int) -> bytes:
    """A signed integer in LEB128."""
    code = bytearray()
    while True:
        low, value = value & 0x7F, value >> 7
        if value == -(low >> 6):
            code.append(low)
            return bytes(code)
        code.append(low | 0x80)


def unsigned(value: int) -> bytes:
    """An unsigned integer in LEB128."""
    code = bytearray()
    while value > 0x7F:
        code.append((value & 0x7F) | 0x80)
        value >>= 7
    return bytes([*code, value])


def name_of(text: str) -> bytes:
    """A name, its length first."""
    return unsigned(len(text)) + text.encode()


def type_of(arguments: int, results: int) -> bytes:
    """The type of a function on numbers."""
    reals = bytes([F64])
    return b"\x60" + unsigned(arguments) + reals * arguments + unsigned(results) + reals * results


def section(number: int, entries: list[bytes]) -> bytes:
    """A section of the module."""
    content = unsigned(len(entries)) + b"".join(entries)
    return bytes([number]) + unsigned(len(content)) + content
