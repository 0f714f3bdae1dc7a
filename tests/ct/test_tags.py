from pydicom.datadict import keyword_for_tag

from ronnaplan.ct import tags


def test_each_element_has_the_number_that_the_standard_gives_its_name() -> None:
    named = {name: value for name, value in vars(tags).items() if name.isupper() and isinstance(value, int)}
    assert {name: keyword_for_tag(value).upper() for name, value in named.items()} == {
        name: name.replace("_", "") for name in named
    }
    assert set(named.values()) == tags.VALUES | tags.SEQUENCES | tags.PIXELS | tags.DELIMITERS
