"""tf2_msgs as it is on a robot, built of the generators and headers that the wheels bring.

PyPI has no wheel of it. The build is what ``rosidl_generate_interfaces`` does: the message's
definition becomes C, its type supports and Python, which a compiler makes libraries of.

    python test/tf2_package.py FOLDER     # builds there; FOLDER/python is for PYTHONPATH

The middleware loads type supports by name alone: each library has its name, and all are loaded
with the package, so that no search path of the system need know of the folder.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np

NAME = 'tf2_msgs'
PREFIX = Path(sys.prefix)
NEEDED = ('geometry_msgs', 'std_msgs', 'builtin_interfaces')
FAST, INTROSPECTION = 'rosidl_typesupport_fastrtps_c', 'rosidl_typesupport_introspection_c'
IMPLEMENTATIONS = ('rosidl_typesupport_c', FAST, INTROSPECTION)


def missing() -> str:
    """What the build lacks here, in words; empty where it has all."""
    if not (PREFIX / 'share' / 'rosidl_generator_py').is_dir():
        return 'no generators of messages beside this Python'
    tools = [name for name in ('gcc', 'g++') if shutil.which(name) is None]
    return f'{", ".join(tools)} not found' if tools else ''


def packages(folder: Path) -> Path:
    """Where Python finds the package that was built in a folder."""
    return folder / 'python'


def build(folder: Path) -> None:
    """Build the package, unless it is there.

    Args:
        folder: is replaced.
    """
    if (folder / 'complete').exists():
        return
    shutil.rmtree(folder, ignore_errors=True)
    (folder / 'lib').mkdir(parents=True)
    _generate(folder)
    _compile(folder)
    (folder / 'complete').touch()


def _generate(folder: Path) -> None:
    """The sources, each generator's in a folder of its own: some have the same names."""
    os.environ.setdefault('AMENT_PREFIX_PATH', str(PREFIX))
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    source = folder / 'source'
    (source / 'msg').mkdir(parents=True)
    definition = Path('msg', 'TFMessage.msg')
    (source / definition).write_text('geometry_msgs/TransformStamped[] transforms\n')
    convert_msg_to_idl(source, NAME, definition, source / 'msg')
    known = NAME, [f'{source}:msg/TFMessage.idl'], [str(PREFIX / 'share')]
    hashes = HashTypeDescription('').generate_type_hashes(*known, source)
    GenerateC('').generate(*known, folder / 'c' / NAME, hashes)
    GenerateFastRTPSCTypesupport('').generate(*known, folder / 'fast' / NAME)
    GenerateIntrospectionCTypesupport('').generate(*known, folder / 'introspection' / NAME)
    both = [FAST, INTROSPECTION]
    dispatch = GenerateCTypesupport('', typesupport_implementations=both)
    dispatch.generate(*known, folder / 'dispatch' / NAME)
    package = folder / 'python' / NAME
    (package / 'msg').mkdir(parents=True)
    (package / '__init__.py').touch()
    python = GeneratePython('', typesupport_implementations=list(IMPLEMENTATIONS))
    python.generate(*known, package)


def _compile(folder: Path) -> None:
    """Its libraries, those that others need first."""
    structs = 'rosidl_generator_c'
    _shared(folder, structs, 'c')
    _shared(folder, FAST, 'fast', structs)
    _shared(folder, INTROSPECTION, 'introspection', structs)
    _shared(folder, 'rosidl_typesupport_c', 'dispatch', structs, FAST, INTROSPECTION)
    _shared(folder, 'rosidl_generator_py', 'python', structs, 'rosidl_typesupport_c')
    package = folder / 'python' / NAME
    suffix = sysconfig.get_config_var('EXT_SUFFIX')
    for kind in IMPLEMENTATIONS:
        target = package / f'{NAME}_s__{kind}{suffix}'
        entry = package / f'_{NAME}_s.ep.{kind}.c'
        _run(folder, [entry], target, ('rosidl_generator_py', *IMPLEMENTATIONS))


def _shared(folder: Path, kind: str, sources: str, *own: str) -> None:
    """One of the package's libraries, of a folder of sources, with others of its own."""
    place = folder / sources / NAME / 'msg'
    found = [path for ending in ('*.c', '*.cpp') for path in place.rglob(ending)]
    _run(folder, found, folder / 'lib' / f'lib{NAME}__{kind}.so', own, kind)


def _run(
    folder: Path, sources: list[Path], target: Path, own: tuple[str, ...], kind: str = ''
) -> None:
    includes = [folder / name for name in ('c', 'fast', 'introspection', 'dispatch', 'python')]
    includes += [PREFIX / 'include', *(PREFIX / 'include').iterdir()]
    includes += [Path(sysconfig.get_path('include')), Path(np.get_include())]
    theirs = [f'{name}__{kind}' for name in NEEDED if kind]
    runtime = ['rosidl_runtime_c', 'rosidl_typesupport_c', FAST, INTROSPECTION, 'rcutils']
    names = [f'{NAME}__{name}' for name in own] + theirs + runtime
    # Where a library is not built for a kind, linking does without.
    found = [n for n in names if any((p / f'lib{n}.so').exists() for p in _places(folder))]
    found += ['fastcdr'] if kind == FAST else []
    compiler = 'g++' if any(path.suffix == '.cpp' for path in sources) else 'gcc'
    command = [compiler, '-shared', '-fPIC', '-O1', '-Wl,--no-as-needed', '-o', str(target)]
    command += [f'-Wl,-soname,{target.name}', *map(str, sources)]
    command += [f'-I{path}' for path in includes]
    command += [f'{word}{path}' for path in _places(folder) for word in ('-L', '-Wl,-rpath,')]
    command += [f'-l{name}' for name in found]
    subprocess.run(command, check=True, capture_output=True, text=True)


def _places(folder: Path) -> tuple[Path, ...]:
    return folder / 'lib', PREFIX / 'lib'


if __name__ == '__main__':
    try:
        build(Path(sys.argv[1]).absolute())
    except subprocess.CalledProcessError as error:
        sys.exit(error.stderr)
