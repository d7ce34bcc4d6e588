"""Every command of the program is a function with its options, defaults and choices."""

import inspect
import os
import re
import tempfile
import typing

import pytest

import cape
from cape import _cape, _program

#: Options of all commands.
GLOBAL = {"help", "version", "json", "quiet", "device", "seed", "threads"}
#: Commands that are no functions of their names.
OTHER_NAMES = {
    "view": [cape.Viewer, cape.export_view],
    "train": [cape.train, cape.check, cape.find_rate],
    "layer predict": [cape.layer.predict, cape.layer.predict_random],
    "fit image": [cape.fit.image, cape.fit.images],
    "fit scan": [cape.fit.scan, cape.fit.garment],
    "fit benchmark image": [cape.fit.benchmark_image],
    "fit benchmark scan": [cape.fit.benchmark_scan],
}
#: Options of a terminal or of graphics cards, or that are a function of their own.
NO_ARGUMENTS = {"tui", "count", "check", "find_rate", "export", "framed", "no_open", "proxied"}
#: Parameters for arguments of the command line, and those of more than one value.
ARGUMENTS = {
    "run": {"model", "runs"},
    "run|layer|mesh|sequence": {"path", "model", "site", "proxy"},
    "registration": {"registrations"},
    "set": {"sets"},
    "file|dir": {"sources"},
    "keypoints": {"masks", "images"},
    "checkpoint_minutes": {"callback"},
}


def printed(*words):
    """Standard output of the program."""
    with tempfile.TemporaryFile() as file:
        terminal = os.dup(1)
        os.dup2(file.fileno(), 1)
        try:
            assert _cape.main(["cape", *words, "--help"]) == 0
        finally:
            os.dup2(terminal, 1)
            os.close(terminal)
        file.seek(0)
        return file.read().decode()


def commands(*words):
    """Help of each command below ``words``."""
    text = printed(*words)
    if not re.search(r"Usage: .*<COMMAND>", text):
        return {" ".join(words): text}
    names = re.findall(r"^  ([a-z0-9-]+) {2,}\S", text.split("\nOptions:")[0], re.M)
    found = {}
    for name in names:
        found.update(commands(*words, name))
    return found


COMMANDS = commands()


def functions(command):
    if command in OTHER_NAMES:
        return OTHER_NAMES[command]
    place = cape
    for name in command.replace("-", "_").split():
        place = getattr(place, name + "_" if name == "import" else name)
    return [place]


def options_of(text):
    """Description of each option and argument of a command by its name."""
    found = {}
    own = text.split("\nGlobal options:")[0]
    for part in re.split(r"\n(?= {2,6}(?:-\w, )?--[a-z]| {2}[<\[])", own)[1:]:
        name = re.match(r" +(?:-\w, )?--([a-z0-9-]+)| {2}[<\[]\[?([A-Z|]+)", part)
        if name:
            option, argument = name.groups()
            found[(option or argument).lower().replace("-", "_")] = " ".join(part.split())
    return {name: text for name, text in found.items() if name not in GLOBAL}


def parameters_of(function):
    parameters = dict(inspect.signature(function).parameters)
    if parameters.pop("settings", None):
        names = cape.training.Settings.__annotations__
        parameters.update(dict.fromkeys(names))
    return {name.rstrip("_"): value for name, value in parameters.items()}


def test_all_commands_are_found():
    assert len(COMMANDS) >= 40 and {"eval run", "model import", "view", "info"} <= set(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_arguments_are_the_options_of_the_program(command):
    options = options_of(COMMANDS[command])
    renamed = set().union(*(ARGUMENTS.get(name, set()) for name in options))
    having = set()
    for function in functions(command):
        parameters = set(parameters_of(function))
        assert parameters <= set(options) | renamed | GLOBAL
        assert function.__doc__
        having |= parameters
    missing = {name for name in options if not having & ({name} | ARGUMENTS.get(name, set()))}
    assert missing <= NO_ARGUMENTS


@pytest.mark.parametrize("command", COMMANDS)
def test_defaults_are_those_of_the_program(command):
    for name, text in options_of(COMMANDS[command]).items():
        said = [numbers(value) for value in re.findall(r"\[default: ([^ \]]+)\]", text)]
        for function in functions(command):
            parameter = parameters_of(function).get(name)
            if parameter is None or parameter.default in (None, inspect.Parameter.empty, False):
                continue
            assert numbers(_program.text(parameter.default)) in said, name


def numbers(text):
    """Numbers of a text with commas, or the text."""
    try:
        return [float(number) for number in text.split(",")]
    except ValueError:
        return text


@pytest.mark.parametrize("command", COMMANDS)
def test_choices_are_those_of_the_program(command):
    for function in functions(command):
        called = function.__init__ if inspect.isclass(function) else function
        hints = {**called.__annotations__}
        for name, text in options_of(COMMANDS[command]).items():
            said = re.search(r"\[possible values: ([^\]]+)\]", text)
            if said and name in hints:
                module = vars(inspect.getmodule(called))
                hint = typing.get_type_hints(stub(name, hints[name]), module)[name]
                assert choices(hint) == set(said[1].split(", ")), name


def stub(name, hint):
    """Something with one annotation, so that those of others need not be known when the program runs."""
    return type("Stub", (), {"__annotations__": {name: hint}})


def choices(hint):
    if typing.get_origin(hint) is typing.Literal:
        return set(typing.get_args(hint))
    return set().union(*(choices(part) for part in typing.get_args(hint)))
