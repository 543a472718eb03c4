"""Options of the commands that several of them have, or that are many."""

import argparse

_LATER = {
    "run": (("--t1", float, None, "with --resume: a later end than that of the case"),
            ("--max-steps", int, "N", "with --resume: more steps than in the case")),
    "branch": (("--max-points", int, "N", "with --resume: more points than in the case"),),
    "equilibrium": (),
}  # fmt: skip
_GO_ON = {
    "run": "go on with the run in DIR, with the case that is kept there",
    "branch": "go on with the branch in DIR, with the case that is kept there",
    "equilibrium": "not for an equilibrium, which takes seconds; says what to do",
}


def add_case(parser) -> None:
    """The case of a run, unless it is resumed."""
    parser.add_argument(
        "case",
        metavar="CASE.toml",
        nargs="?",
        help="a case file, or example:NAME for one of the examples",
    )


def add_out(parser, words: str, required: bool = True) -> None:
    """The folder to write to."""
    parser.add_argument("--out", required=required, metavar="DIR", type=folder_name, help=words)


def add_resume(parser, command: str) -> None:
    """The folder to go on in, and what may be asked for then."""
    parser.add_argument("--resume", metavar="DIR", type=folder_name, help=_GO_ON[command])
    for name, kind, metavar, words in _LATER[command]:
        parser.add_argument(name, type=kind, metavar=metavar, help=words)


def later_of(args: argparse.Namespace, command: str) -> dict[str, float | int | None]:
    """What is asked for of a run that goes on, by name."""
    names = [name[2:].replace("-", "_") for name, *_ in _LATER[command]]
    return {name: getattr(args, name) for name in names}


def check_resume(args: argparse.Namespace, command: str) -> None:
    """A run begins with a case and a folder, and goes on with neither; else the command ends."""
    if args.resume is None:
        given = {"CASE.toml": args.case, "--out": args.out}
        missing = [name for name, value in given.items() if value is None]
        if missing:
            args.parser.error(f"the following arguments are required: {', '.join(missing)}")
        if any(value is not None for value in later_of(args, command).values()):
            names = " and ".join(name for name, *_ in _LATER[command])
            verb = "go" if len(_LATER[command]) > 1 else "goes"
            args.parser.error(f"{names} {verb} with --resume; the case file says it otherwise")
    elif args.case is not None or args.out is not None or args.replace:
        args.parser.error("--resume DIR takes no case, no --out and no --replace: all is in DIR")


def folder_name(text: str) -> str:
    """The name of a folder, as an argument."""
    if not text.strip():
        raise argparse.ArgumentTypeError(
            f"needs the name of a folder (`.` is the current one); got {text!r}"
        )
    return text


def add_check_options(check) -> None:
    """Those of `jaxwillmore check`."""
    check.add_argument("mesh", metavar="MESH", help="a file .ply .off .obj .stl .npz .vtu")
    for name, kind, words in (
        ("--repair", str, "write the mesh here (.ply, .npz), without unused vertices, collapsed "
         "or repeated faces, normals turned out"),
        ("--merge-tolerance", float, "make one vertex of vertices closer than this"),
        ("--components", int, "how many separate pieces there should be (default: 1)"),
        ("--genus", int, "how many handles there should be"),
    ):  # fmt: skip
        metavar = {str: "OUT", float: "LENGTH", int: "N"}[kind]
        check.add_argument(name, type=kind, metavar=metavar, help=words)
    check.add_argument("--keep", choices=["largest"], help="keep so many of the largest pieces")
