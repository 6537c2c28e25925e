"""Where the explorer listens, and who is let in."""

import pytest

from erosion.explorer.state import Address, without_token

OWN = Address("127.0.0.1", 8080)
SHARED = Address("0.0.0.0", 8080, "a-token")


def test_only_other_hosts_than_the_own_machine_need_a_token() -> None:
    own, shared = Address.free("127.0.0.1", 0), Address.free("0.0.0.0", 0)
    assert own.token == ""
    assert own.admits("")
    assert own.link == f"http://127.0.0.1:{own.port}/"
    assert len(shared.token) == 22
    assert shared.token != Address.free("0.0.0.0", 0).token
    assert shared.link.endswith(f":{shared.port}/?token={shared.token}")
    assert "0.0.0.0" not in shared.link
    assert shared.token not in repr(shared)


@pytest.mark.parametrize("token", ["", "a-toke", "a-token ", "A-TOKEN", "ä-token", "\x00"])
def test_another_token_is_not_admitted(token: str) -> None:
    assert SHARED.admits("a-token")
    assert not SHARED.admits(token)


def test_the_link_names_an_ipv6_address_in_brackets() -> None:
    assert Address("fe80::1", 8080, "t").link == "http://[fe80::1]:8080/?token=t"
    assert Address("fe80::1", 8080, "t").is_own("[fe80::1]:8080", "fe80::1")


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost:8080", "192.168.1.20:8080", "192.168.1.20"])
def test_names_of_this_machine_are_its_own(host: str) -> None:
    assert SHARED.is_own(host, "192.168.1.20")


@pytest.mark.parametrize(
    "host", ["evil.example:8080", "192.168.1.20.evil.example", "0.0.0.0:8080", "none", "[::]", "a@b"]
)
def test_other_names_are_not(host: str) -> None:
    assert not SHARED.is_own(host, "192.168.1.20")
    assert not SHARED.is_own(host, None)


def test_an_explorer_of_this_machine_alone_has_two_names() -> None:
    assert OWN.is_own("127.0.0.1:1", "127.0.0.1")
    assert not OWN.is_own("192.168.1.20:8080", "192.168.1.20")


@pytest.mark.parametrize(
    ("query", "token", "rest"),
    [
        ("token=t", "t", ""),
        ("k=3&token=t&alpha=20+deg", "t", "k=3&alpha=20+deg"),
        ("k=3", None, "k=3"),
        ("token=", "", ""),
        ("", None, ""),
    ],
)
def test_the_token_is_taken_out_of_a_link(query: str, token: str | None, rest: str) -> None:
    assert without_token(query) == (token, rest)
