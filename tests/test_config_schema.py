"""The schema and the reference know the good files and the bad ones, and nothing but faults comes of any mutation."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from conftest import GOODS

from psfcli.config import ConfigError, reference, schema
from psfcli.config.tree import atom


def core(text: str) -> Any:
    """A text as YAML 1.2 reads it: our numbers in the places of the parser's words."""

    def read(node: yaml.Node) -> Any:
        if isinstance(node, yaml.MappingNode):
            return {key.value: read(value) for key, value in node.value}
        if isinstance(node, yaml.SequenceNode):
            return [read(item) for item in node.value]
        return atom(node.value) if node.style is None else node.value

    return read(yaml.compose(text, Loader=yaml.SafeLoader))


def test_the_schema_is_valid_and_knows_the_good_files() -> None:
    jsonschema.Draft202012Validator.check_schema(schema())
    for text in GOODS:
        jsonschema.validate(core(text), schema(), cls=jsonschema.Draft202012Validator)


@pytest.mark.parametrize(
    "name",
    [
        "unknown_key",
        "missing_pixel",
        "bare_pixel",
        "too_many_pixels",
        "two_amplitudes",
        "no_amplitude",
        "both_conjugates",
        "zemax_key_in_harvey",
        "unknown_accuracy",
        "band_without_sigma",
        "obscuration_one",
        "psd_is_a_number",
        "prescription_and_focal_length",
        "prescription_and_marginal_height",
        "prescription_missing_radius",
        "prescription_missing_stop",
        "prescription_radius_word",
        "prescription_odd_aspheric",
    ],
)
def test_the_schema_refuses_files_of_the_wrong_structure(name: str) -> None:
    text = (Path(__file__).parent / "bad_configs" / f"{name}.yaml").read_text()
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(core(text), schema(), cls=jsonschema.Draft202012Validator)


def test_the_reference_names_every_key() -> None:
    assert all(
        f"| `{key}` |" in reference() for key in ("schema", "sigma_band", "sigma_wavelength", "half_widths", "W311")
    )


SCRAPS = ["", " ", "\n", "\t", ":", "- ", "[", "}", "&a ", "*a", "!x ", "nan", "1e999", "-", "0", '"', "'", "\\", "|"]
SCRAPS += ["é", "\0", "deg", "Mm", "<<: ", "? ", "#", "%", "@", "...", "---\n", "null", "9" * 500, "mag", "1/0 "]


def test_no_mutation_of_a_good_file_gives_anything_but_a_system_or_faults(system: Any) -> None:
    rng = random.Random(20120701)
    faults: list[str] = []
    good = 0
    for _ in range(1000):
        text = rng.choice(GOODS)
        for _ in range(rng.randint(1, 3)):
            start = rng.randrange(len(text))
            text = text[:start] + rng.choice(SCRAPS) + text[start + rng.choice([0, 0, 1, 3, 20]) :]
        try:
            good += bool(system(text).wavelengths)
        except ConfigError as error:
            faults += error.faults
    assert good > 10
    assert len(faults) > 100
    assert all(line.isprintable() for line in faults)
