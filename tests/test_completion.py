"""Shell completion: what bash really offers, and that the other shells' scripts know the verbs."""

import shutil
import subprocess

import pytest

from gpdf_service.cli import VERBS, main
from gpdf_service.cli.completion import SHELLS, whole_parser


def script(shell, capsys):
    assert main(["completion", shell]) == 0
    return capsys.readouterr().out


def offered(script_file, *words):
    """What bash offers for the last of the words."""
    ask = f"""
        source {script_file}
        COMP_WORDS=({" ".join(f"'{word}'" for word in words)}); COMP_CWORD={len(words) - 1}
        $(complete -p gpdf | sed 's/.*-F \\([^ ]*\\).*/\\1/') gpdf '{words[-1]}' '{words[-2]}'
        printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    done = subprocess.run(["bash", "-c", ask], capture_output=True, text=True, check=True)
    return {line.strip() for line in done.stdout.splitlines()}


def test_bash_offers_verbs_options_choices_and_files(tmp_path, capsys):
    file = tmp_path / "gpdf.bash"
    file.write_text(script("bash", capsys))
    assert {verb.split()[0] for verb in VERBS} <= offered(file, "gpdf", "")
    assert offered(file, "gpdf", "scene", "") >= {"build", "info"}
    assert offered(file, "gpdf", "plan", "--me") == {"--method"}
    assert offered(file, "gpdf", "plan", "x.ply", "--method", "pr") == {"prm"}
    assert offered(file, "gpdf", "client", "sta") == {"status"}
    (tmp_path / "room.ply").touch()
    assert offered(file, "gpdf", "plan", f"{tmp_path}/roo") == {f"{tmp_path}/room.ply"}


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shells_script_is_complete_and_well_formed(shell, tmp_path, capsys):
    text = script(shell, capsys)
    for word in ("replay", "log-segment-mb", "cluttered_office"):
        assert word in text
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed: its script was not read by it")
    file = tmp_path / "script"
    file.write_text(text)
    assert subprocess.run([shell, "-n", str(file)], capture_output=True).returncode == 0


def test_the_completed_command_line_is_the_one_that_runs():
    """Words that the joined parser takes are those that the verbs take."""
    args = whole_parser().parse_args(["bench", "plan", "--count", "3", "--agent", "human"])
    assert (args.count, args.agent) == (3, ["human"])
