"""`python -m undeadzone` is the command line, like the installed command."""

import itertools
import os
import sys


def main() -> None:
    """Run the command line. Ctrl-C during its import also ends with one line."""
    try:
        if _is_run_by_strangers():
            sys.stderr.write(
                "undeadzone: --untrusted: python -m takes modules from the folder in which it is "
                "started. Use python -P -m undeadzone, or the command undeadzone\n"
            )
            sys.exit(2)
        from undeadzone.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.stderr.write("undeadzone: interrupted\n")
        sys.exit(130)


def _is_run_by_strangers() -> bool:
    """Return whether modules may come from a folder that --untrusted names."""
    if sys.flags.safe_path or "-m" not in sys.orig_argv[1 : -len(sys.argv[1:]) or None]:
        return False
    here = os.path.realpath(os.curdir)
    words = sys.argv[1:]
    named = [after for word, after in itertools.pairwise(words) if word == "--untrusted"]
    named += [word.partition("=")[2] for word in words if word.startswith("--untrusted=")]
    return any(
        os.path.commonpath([here, os.path.realpath(n)]) == os.path.realpath(n) for n in named
    )


if __name__ == "__main__":
    main()
