"""Mistakes that the YAML and schema libraries find, in the words of the author of a file; reads no file."""

from __future__ import annotations

YAML = {
    "mapping values are not allowed": "is the line indented further than the one above? A text that holds ': ' "
    "needs quotes",
    "found character '\\t'": "a tab; YAML is indented with spaces",
    "found character": "a value that begins with this sign needs quotes",
    "could not find expected ':'": "a key without ':', or a line that is indented less than the text it belongs to",
    "expected <block end>": "the line is indented neither like the one above nor like a line further up",
    "expected ',' or": "a list or map in brackets lacks a comma or its closing bracket",
    "did not find expected": "a list or map in brackets lacks a comma or its closing bracket",
    "expected the node content": "a bracket is not closed, or a value is missing",
    "found unexpected end of stream": "a quote is not closed",
    "found undefined alias": "'*' begins a reference in YAML; a text that begins with it needs quotes",
}
"""How the YAML library's sentence begins -> what to look for in the line."""

VALUES = {
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "string": "a text (in quotes)",
    "date": "a day, for instance 2026-11-23",
    "datetime": "a day with a time, for instance 2026-11-23 14:05:00",
}
"""What the schema library calls a value -> what is expected."""


def yaml_mistake(problem: str) -> str:
    """What is wrong with a text that is no YAML."""
    return next((words for begin, words in YAML.items() if problem.startswith(begin)), problem)


def wrong_value(kind: str, value: object, message: str) -> str:
    """What is wrong with a value, from the library's kind of error and its sentence."""
    first, _, rest = kind.partition("_")
    if first in VALUES and (rest in {"type", "parsing"} or rest.startswith("from_")):
        return f'"{value}" is not {VALUES[first]}'
    message = message.replace("Input should be", f'"{value}" should be')
    return message[0].lower() + message[1:] if message[:1].isupper() else message
