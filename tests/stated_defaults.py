"""The defaults that docstrings state, and those that functions have."""

import ast
import importlib
import inspect
import re
from pathlib import Path

import skat

CODE = Path(skat.__file__).parent


def modules_of(package):
    """Return the names of a package's modules."""
    folder = CODE.joinpath(*package.split(".")[1:])
    names = (
        ".".join(("skat", *path.relative_to(CODE).with_suffix("").parts)) for path in folder.rglob("*.py")
    )
    return sorted(name.removesuffix(".__init__") for name in names)


def untrue_defaults(module):
    """Return a sentence for each default that a docstring of a module states and the signature does not have."""
    return [
        f"{name}: the docstring says {parameter}, default={stated}, and the signature says {own!r}: write there what "
        "holds"
        for name, thing in _documented(importlib.import_module(module))
        for parameter, stated in _stated(thing.__doc__ or "")
        for own in [_own_defaults(thing).get(parameter, "nothing")]
        if not _is(stated, own)
    ]


def _documented(module):
    for name, thing in vars(module).items():
        if getattr(thing, "__module__", None) != module.__name__:
            continue
        if inspect.isclass(thing):
            yield f"{module.__name__}.{name}", thing
            for part, one in vars(thing).items():
                method = getattr(one, "__func__", one)
                if inspect.isfunction(method):
                    yield f"{module.__name__}.{name}.{part}", method
        elif inspect.isfunction(thing):
            yield f"{module.__name__}.{name}", thing


def _stated(docstring):
    for names, stated in re.findall(r"^ *(\w[\w, ]*) : .*default=(.+)$", docstring, re.MULTILINE):
        for name in names.split(","):
            yield name.strip(), stated


def _own_defaults(thing):
    return {name: one.default for name, one in inspect.signature(thing).parameters.items()}


def _is(stated, own):
    try:
        return ast.literal_eval(stated) == own
    except (ValueError, SyntaxError):
        return stated == getattr(own, "__name__", None)
