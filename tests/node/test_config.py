"""node.toml is read to the letter, and the example that --init writes is one."""

from __future__ import annotations

from pathlib import Path

import pytest

from ronnaplan.cli import main
from ronnaplan.errors import InputError
from ronnaplan.node.config import Config, read_config
from ronnaplan.node.work import Order


def test_the_example_is_a_configuration_that_listens_on_this_machine_only(tmp_path: Path) -> None:
    path = tmp_path / "node.toml"
    assert main(["node", "--config", str(path), "--init"]) == 0
    config = read_config(path)
    assert config.host == "127.0.0.1"
    assert config.rule[0].receivers == ("pacs",)
    assert config.data == tmp_path / "node-data"
    left_out = Config()
    assert (config.limits, config.jobs) == (left_out.limits, left_out.jobs)
    assert (config.quiet_s, config.missing_s, config.keep_days) == (
        left_out.quiet_s,
        left_out.missing_s,
        left_out.keep_days,
    )
    assert main(["node", "--config", str(path), "--init"]) == 2


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("port = '11112'", "port"),
        ("port = 70000", "port"),
        ("prot = 1", "prot: no field"),
        ("home = '/'", "home: no field"),
        ("titles = []", "at least one AE title"),
        ("titles = ['a\\\\b']", "is no AE title"),
        ("[[rule]]\nname = 'a'\nreceivers = ['pacs']", "no peer"),
        (
            "[[peer]]\nname = 'ct'\nsends = true\n[[rule]]\nname = 'a'\nreceivers = ['ct']",
            "nowhere to send to",
        ),
        ("[[peer]]\nname = 'a'\n[[peer]]\nname = 'a'", "same name"),
        ("[[peer]]\nname = 'a'\ntls = true", "asks for TLS"),
        ("[[peer]]\nname = 'a'\nurl = 'ftp://x'", "http"),
        ("[[rule]]\nname = 'a'\nmarker = 'cube'", "rule.0.marker: the marker is 'cube'; expected solid"),
        (
            "[[rule]]\nname = 'a'\ndiameters = [11.5]\nmarker = 'shell:6'",
            "rule.0: the wall of 6 mm leaves nothing hollow",
        ),
        ("port = 4242\npage_port = 4242", "page_port: 4242 is the port that peers send to"),
        ("port = 2020-01-01", r"\(port: Input should be a valid integer\)"),
        ("[[rule]]\nname = 2020-01-01", r"\(rule.0.name: Input should be a valid string\)"),
        ("host = ''", r"\(host: "),  # it would listen on every address
        ("[[peer]]\nname = 'a'\nhost = ' '", r"\(peer.0.host: "),
        ("folder = ''", r"\(folder: "),
        ("audit = ''", r"\(audit: "),
        ("[[rule]]\nname = 'a'\ndiameters = [11,5]", r"rule.0.diameters: \[11, 5\] may be 11.5 mm or 2 diameters"),
        ("port = ", "not a node's configuration"),
    ],
)
def test_what_a_configuration_cannot_say_is_refused_by_name(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "node.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=says):
        read_config(path)


def test_several_whole_diameters_are_several_where_each_has_a_point(tmp_path: Path) -> None:
    (tmp_path / "node.toml").write_text("[[rule]]\nname = 'a'\ndiameters = [11.0, 5.0]\n")
    (rule,) = read_config(tmp_path / "node.toml").rule
    order = Order(1, tmp_path, 3, tmp_path, tmp_path, rule, ())
    assert Order.parse(order.text).rule.diameters == rule.diameters == (11.0, 5.0)


def test_a_page_port_that_is_left_out_is_none(tmp_path: Path) -> None:
    """As the example says; TOML has no word for none."""
    path = tmp_path / "node.toml"
    path.write_text("port = 0")
    assert read_config(path).page_port is None
