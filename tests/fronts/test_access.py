"""Whom a server answers that a browser can reach."""

import pytest

from drsplat.fronts.serving.listening import is_addressed, is_loopback, is_own_page, is_secret, names_of


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.9.1", "localhost", "LOCALHOST", "::1", "[::1]"])
def test_loopback_is_this_machine(host):
    assert is_loopback(host)


@pytest.mark.parametrize("host", ["", "0.0.0.0", "::", "192.168.1.5", "localhost.evil.example", "127.0.0.1.example"])
def test_what_others_reach_is_not(host):
    assert not is_loopback(host)


@pytest.mark.parametrize("header", ["localhost", "localhost:8080", "127.0.0.1:1", "[::1]:8080", "LocalHost:8080"])
def test_a_loopback_server_answers_to_its_names(header):
    assert is_addressed(header, names_of("127.0.0.1"))


@pytest.mark.parametrize(
    "header",
    [
        "",
        ":8080",
        "evil.example",
        "evil.example:8080",
        "localhost.evil.example",
        "127.0.0.1.evil.example:8080",
        "localhost:8080@evil.example",
        "evil.example#localhost",
        "localhost:8080:1",
        "localhost\r\n",
        " localhost",
        "10.0.0.1",
    ],
)
def test_and_to_no_other(header):
    assert not is_addressed(header, names_of("127.0.0.1"))


def test_a_given_host_is_a_name_too_and_everywhere_has_any():
    assert is_addressed("lab.example:80", names_of("Lab.example"))
    assert is_addressed("[fe80::1]:80", names_of("fe80::1"))
    assert is_addressed("any.example:8080", names_of("0.0.0.0"))
    assert not is_addressed("any.example:80 <script>", names_of("0.0.0.0"))


def test_another_origin_port_or_none_that_is_named_is_not_the_own_page():
    here = "localhost:8080"
    assert is_own_page(None, here)
    assert is_own_page("http://localhost:8080", here)
    assert is_own_page("https://LOCALHOST:8080", here)
    for other in (
        "null",
        "",
        "http://localhost:3000",
        "http://localhost",
        "http://evil.example",
        "http://localhost:8080.evil.example",
        "file://",
    ):
        assert not is_own_page(other, here)


def test_a_secret_is_itself_and_nothing_else():
    assert is_secret("a" * 32, "a" * 32)
    assert is_secret(b"a" * 32, "a" * 32)
    for other in ("", "a", "a" * 31, "a" * 33, "é", "\udcff"):
        assert not is_secret(other, "a" * 32)
