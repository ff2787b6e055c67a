"""Word tests and patterns of the language rules. `words.toml` holds the word lists."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

WORDS = {
    name: frozenset(text.split())
    for name, text in tomllib.loads(
        Path(__file__).with_name("words.toml").read_text(encoding="utf-8")
    ).items()
}
VAGUE = re.compile(
    r"\b(what|which|one|ones|them|these|those|there|such|it|anew|begun|told|heard|else|others?"
    r"|another)\b",
    re.IGNORECASE,
)
RIDDLE = re.compile(r"(What|Which|Whether|How|Where|Why)\b")

# Habits of prose. A blank in a pattern matches any white space.
HABITS = {
    "told, hear, ask, say": r"\b(told|tell(s|ing)?|hear(s|d|ing)?|spoken?|speak(s|ing)?"
    r"|ask(s|ed|ing)?|listen(s|ed|ing)?|say(s|ing)?|said)\b",
    "claim": r"\bclaim\w*",
    "what-clauses": r"\b(what|whatever) (is|are|was|it|they|no|else|remains|differs|comes|follows"
    r"|hides|stands|lies|the|a|can|must|one|others?)\b",
    "is no, none of, nor": r"(?<!there\s)\b(is|are|was|were) (no|none)\b|\bnone of\b|\bnor\b",
    "where for if": r"\bwhere (a|an|the|no|nothing|it|they|one|z|y|u|there|its|all|both|most"
    r"|more)\b",
    "decimals without 0": r"(?<![\w.)\]])\.\d+\b",
    "semicolons": r";",
}
PATTERNS = {
    habit: re.compile(pattern.replace(" ", r"\s+"), re.IGNORECASE)
    for habit, pattern in HABITS.items()
}


CODE = re.compile(
    r"[{}<>=\\]|;(?=\n|$)|\(\w*\);|@\w+@|\breturn\b|^\W*(?:static|double|var|#)", re.M
)


def split_name(name: str) -> list[str]:
    """Split a name in snake case into its words."""
    return [word for word in name.lower().split("_") if word]


def is_participle(name: str) -> bool:
    """Test if a name begins with a participle, such as `heard` or `fitted_with_delay`."""
    words = split_name(name)
    if not words or words[0] in WORDS["verbs"]:
        return False
    return words[0] in WORDS["participles"] or re.fullmatch(r"\w{2,}[^e]ed", words[0]) is not None


def is_imperative(line: str) -> bool:
    """Test if a line begins with a verb in the imperative."""
    words = re.findall(r"[a-z]+|\S", line.lower())
    if not words or words[0] not in WORDS["verbs"] or words[1:2] == ["of"]:
        return False
    return words[0] not in WORDS["also_nouns"] or not WORDS["followers"].isdisjoint(words[1:2])


def is_prose(text: str) -> bool:
    """Test if a string is a sentence or a part of one: three words, and no code or page."""
    return len(re.findall(r"(?<!\S)[a-z]{2,}\b", text)) > 2 and not CODE.search(text)


def strip_markdown(text: str) -> str:
    """Return the prose of a page without code, tables, formulas and addresses.

    Lines keep their numbers. Code and formulas inside a sentence become an X.
    """
    text = re.sub(r"```.*?```|<!--.*?-->|\$\$.*?\$\$", _blank, text, flags=re.DOTALL)
    text = re.sub(r"(?m)^[ \t]*\|.*$", "", text)
    text = "\n".join(_without_indented_code(text.splitlines()))
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)|<[^>\n]+>|&\w+;", _blank, text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return strip_code_words(text)


def strip_docstring(text: str) -> str:
    """Return the prose of a docstring without its examples; lines keep their numbers."""
    lines, inside = [], False
    for line in text.splitlines():
        inside = bool(line.strip()) and (inside or line.lstrip().startswith(">>>"))
        lines.append("" if inside else line)
    return strip_code_words("\n".join(lines))


def strip_code_words(text: str) -> str:
    """Replace code and formulas inside sentences by an X."""
    return re.sub(r"``[^`\n]*``|`[^`]*`|\$[^$\n]*\$", lambda found: "X" + _blank(found), text)


def _blank(found: re.Match[str]) -> str:
    return "\n" * found[0].count("\n")


def _without_indented_code(lines: list[str]) -> list[str]:
    """Blank the blocks of code: indented by four, after an empty line, no item of a list."""
    lines_of_prose, may_be_code = [], True
    for line in lines:
        indented = re.match(r"(    |\t)\s*(?![*+-] |\d+\. )\S", line) is not None
        may_be_code = not line.strip() or (may_be_code and indented)
        lines_of_prose.append("" if may_be_code else line)
    return lines_of_prose
