#!/usr/bin/env python3
"""Count sentences that docs/style.md forbids, and compare the counts with a list.
    tools/lint/check_prose.py              counts for each group of texts
    tools/lint/check_prose.py --lists      also print the sentences
    tools/lint/check_prose.py --check      compare the counts with tools/lint/prose.txt
    tools/lint/check_prose.py --write      write lower counts, and remove entries without a fault

prose.txt has the count of known faults of each file. The counts may only shrink. The texts are
README, guides, pages, design notes, docstrings of Python and of the bindings, and the comments at
the head of C++ headers. Code, formulas and headings do not count.
"""

from __future__ import annotations

import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator

from prose_sources import GROUPS, Text, read_texts
from ratchet import check_or_write, read_options

MOST_WORDS = 30  # in a sentence
MOST_PARAGRAPH_WORDS = 90
LEAST_WORDS = 4  # a shorter text is a label of a table and not a sentence

HEAD = """\
# Today's faults of prose by file. The numbers may only shrink: tools/lint/check_prose.py --check
# compares, --write writes lower numbers.
"""

ABBREVIATION = re.compile(r"\b(e\.g|i\.e|cf|vs|Fig|eq|Eq|etc|al|no|No|resp|approx)\.(?=\s)")
END = re.compile(r"(?<=[.!?])[\"')\]*]*\s+(?=[A-Z\"'(\[*]|code\b|\d)")
# Openings that hide the subject of a sentence, or that stand for a noun of another sentence.
OPENING = re.compile(
    r"(of|what|that|those|others|it|they|who|whose|which|nor)\b(?![-'])"
    r"|there\b(?! (is|are|was|were)\b)",
    re.IGNORECASE,
)


def words(text: str) -> int:
    """Return the number of words. A sign without a letter or digit is not a word."""
    return sum(1 for word in text.split() if re.search(r"\w", word))


def sentences(blocks: list[str]) -> Iterator[str]:
    """Yield the sentences of some blocks."""
    for block in blocks:
        marked = ABBREVIATION.sub(r"\1", block)
        yield from (sentence.strip(" *\"'(") for sentence in END.split(marked))


def is_long(sentence: str) -> bool:
    """Return whether a sentence has too many words."""
    return words(sentence) > MOST_WORDS


def opens_badly(sentence: str) -> bool:
    """Return whether a sentence begins with a forbidden opening. A question may begin with one."""
    return bool(OPENING.match(sentence)) and not sentence.rstrip(")*\"' ").endswith("?")


def long_sentences(text: Text) -> list[str]:
    """Return the sentences of a file with too many words."""
    return [sentence for sentence in sentences(text.blocks) if is_long(sentence)]


def bad_openings(text: Text) -> list[str]:
    """Return the sentences of a file with a forbidden opening."""
    return [sentence for sentence in sentences(text.blocks) if opens_badly(sentence)]


def long_paragraphs(text: Text) -> list[str]:
    """Return the paragraphs of a file with too many words."""
    return [block for block in text.blocks if words(block) > MOST_PARAGRAPH_WORDS]


FAULTS: dict[str, Callable[[Text], list[str]]] = {
    f"sentences over {MOST_WORDS} words": long_sentences,
    "forbidden openings": bad_openings,
    f"paragraphs over {MOST_PARAGRAPH_WORDS} words": long_paragraphs,
}


def print_figures(texts: list[Text]) -> None:
    """Print a line of counts for each group of texts."""
    print(f"{'':18}{'files':>6}{'sentences':>11}{'mean words':>12}", end="")
    print(f"{f'over {MOST_WORDS}':>9}{'share':>8}{'openings':>10}{'paragraphs':>12}")
    for group in GROUPS:
        mine = [text for text in texts if text.group == group]
        lengths = [words(sentence) for text in mine for sentence in sentences(text.blocks)]
        lengths = [length for length in lengths if length >= LEAST_WORDS] or [0]
        number = {title: sum(len(find(t)) for t in mine) for title, find in FAULTS.items()}
        long, bad, paragraphs = number.values()
        mean, share = sum(lengths) / len(lengths), 100 * long / len(lengths)
        print(f"{group:18}{len(mine):6}{len(lengths):11,}{mean:12.1f}", end="")
        print(f"{long:9}{share:7.1f}%{bad:10}{paragraphs:12}")


def print_faults(texts: list[Text]) -> None:
    """Print all sentences and paragraphs with a fault."""
    for title, find in FAULTS.items():
        print(f"\n[{title}]")
        for text in texts:
            for fault in find(text):
                print(f"{text.name}: {words(fault)}: {fault}")


def main(arguments: list[str]) -> int:
    """Print the counts, compare them with the list, or write the list."""
    options = read_options(arguments, "Count sentences that docs/style.md forbids.", "sentence")
    texts = read_texts(options.root)
    if not (options.check or options.write):
        print_figures(texts)
        if options.lists:
            print_faults(texts)
        return 0
    now: dict[str, dict[str, int]] = defaultdict(dict)
    for title, find in FAULTS.items():
        now[title] = {text.name: len(found) for text in texts if (found := find(text))}
    path = options.root / "tools" / "lint" / "prose.txt"
    return check_or_write("check_prose", path, HEAD, now, options.write, len(texts))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
