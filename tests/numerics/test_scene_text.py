"""Names that the checks read in a scene file are those that Mitsuba's parser opens; what expands is bounded."""

import os
import random
from pathlib import Path

import pytest

from sarmitsuba.commands.scenes import copy_scene
from sarmitsuba.core.errors import SceneError
from sarmitsuba.loading.load import load_scene
from sarmitsuba.loading.references import check_document, read_scene_text
from sarmitsuba.machine.backend import mi

HEADS = (
    *(b"",) * 20,
    b"\xef\xbb\xbf",
    b'<?xml version="1.0"?>',
    b"<?xml version='1.0' encoding='UTF-8'?>\n",
    b'<?xml version="1.0" encoding="koi8-r"?>',
    b'<?xml version="1.0" encoding="ISO-8859-1"?>',
    b'<?xml version="1.0" encoding="us-ascii"?>',
    b'<?xml version="1.0" standalone="yes" encoding = "latin1"?>',
    b'\n<?xml version="1.0"?>',
    b'<!DOCTYPE scene [<!ENTITY e "x">]>',
    b"<!-- a -->",
    b"<?pi encoding='latin1'?>",
)
NAMES = (
    *(b"a.xml", "é.xml".encode(), b"\xe9.xml", b"&#x2f;a.xml", b"&#233;", b"&amp;amp;", b"&e;", b"a&b"),
    *(
        b" a\tb\nc\r\nd\re ",
        b"&#10;&#13;&#9;x",
        b"a&#0;b",
        b"a\x00b",
        b"a<b",
        b"a>b",
        b"&#xD800;",
        b"&#38;#47;",
    ),
    *(
        b"&lt;include filename=&quot;q&quot;/>",
        b"'",
        b"&apos;&#39;",
        b"a\x01b",
        b"",
        b"\xc3",
        b"\xed\xa0\x80",
    ),
)
AROUND = (
    *(b"@",) * 40,
    b"<!-- @ -->",
    b"<!--@--->",
    b"<!-->@-->",
    b"<!-- a -- @ -->",
    b"<![CDATA[@]]>",
    b"<![CDATA[ ]]>@<![CDATA[]]]]>",
    b"<?pi @ ?>",
    b"<?pi > ?>@",
    b"text ]]> @",
    b"</scene>@",
    b"<bsdf type='x'>@",
    b"</bsdf>@",
    b"<!DOCTYPE a>@",
    b"<!ELEMENT a>@",
    b"@\x00",
)
FORMS = (
    *(b'<include filename="%s"/>',) * 20,
    b"<include filename='%s'/>",
    b'<include filename="%s"></include>',
    b'<include filename="%s" filename="b"/>',
    b'<include filename="%s" x="<!--"/>',
    b'<include filename="%s"\n\t/>',
    b'<include filename="%s">&e;<!-- --></include>',
    b'<x:include filename="%s"/>',
    b'<include filename="%s"',
)


def drawn(rng: random.Random) -> bytes:
    """A scene file of one to four names in odd places."""
    parts = []
    for _ in range(rng.randint(1, 4)):
        name, form = rng.choice(NAMES[:2] * 20 + NAMES), rng.choice(FORMS)
        parts.append(rng.choice(AROUND).replace(b"@", b"<bsdf type='b'>" + form % name + b"</bsdf>"))
    return rng.choice(HEADS) + b'<scene version="3.0.0">' + b"".join(parts) + b"</scene>"


def test_names_are_those_that_the_parser_sees(tmp_path: Path) -> None:
    """What is read is refused, or holds the names that Mitsuba's own parser finds there, in order.

    For Mitsuba each ``<include filename=`` becomes a string, in the same bytes otherwise: nothing is opened. Naive way:
    an encoding that is declared is honoured by one parser and not by the other.
    """
    path, taken, strange = tmp_path / "s.xml", 0, 0
    config = mi.parser.ParserConfig("scalar_rgb")
    for seed in range(600):
        data = drawn(random.Random(seed))
        path.write_bytes(data)
        try:
            checked = [name for _, name in read_scene_text(path).references]
        except SceneError:
            continue
        taken += 1
        path.write_bytes(data.replace(b"<include filename=", b'<string name="f" value='))
        try:
            nodes = mi.parser.parse_file(config, str(path)).nodes
        except RuntimeError:
            continue  # nothing was opened up to there but what is read in order
        seen = [node.props["f"] for node in nodes if "f" in node.props.keys()]
        assert seen == [name for name in checked], f"seed {seed}: {data!r}"
        strange += b"&" in data or b"!" in data or b"?" in data
    assert taken > 100 and strange > 50


@pytest.mark.parametrize("encoding", ["koi8-r", "utf-16", "utf-16-le", "iso-8859-1", "utf-32"])
def test_other_encodings_are_refused(tmp_path: Path, encoding: str) -> None:
    text = '<scene version="3.0.0"><bsdf type="diffuse"/></scene>'
    head = f'<?xml version="1.0" encoding="{encoding}"?>'
    (tmp_path / "part.xml").write_bytes((head + text).encode(encoding, "replace"))
    path = tmp_path / "s.xml"
    path.write_text('<scene version="3.0.0"><include filename="part.xml"/></scene>')
    with pytest.raises(SceneError, match=r"part.xml: (a scene file is in UTF-8|malformed)"):
        check_document(path)


def nest(folder: Path, depth: int, width: int) -> Path:
    """A scene of files that include the next ``width`` times each."""
    for i in range(depth):
        body = f'<include filename="i{i + 1}.xml"/>' * width if i < depth - 1 else '<bsdf type="diffuse"/>'
        (folder / f"i{i}.xml").write_text(f'<scene version="3.0.0">{body}</scene>')
    return folder / "i0.xml"


@pytest.mark.parametrize(("depth", "width"), [(6, 10), (12, 10), (14, 900)])
def test_includes_of_includes_are_counted_not_read(tmp_path: Path, depth: int, width: int) -> None:
    path = nest(tmp_path, depth, width)
    for read in (load_scene, check_document, lambda one: copy_scene(one, tmp_path / "to")):
        with pytest.raises(SceneError, match=r"its includes expand to \w+ files, more than the bound 1000"):
            read(path)
    assert not (tmp_path / "to").exists()


def test_counts_of_includes_are_those_of_reading_them_all(tmp_path: Path) -> None:
    """Drawn graphs of includes, against Mitsuba, which reads every one of them."""
    config, compared = mi.parser.ParserConfig("scalar_rgb"), 0
    for seed in range(40):
        rng, folder = random.Random(seed), tmp_path / str(seed)
        folder.mkdir()
        for i in range(6):
            below = "".join(
                f'<include filename="i{rng.randint(i + 1, 6)}.xml"/>' for _ in range(rng.randint(0, 4))
            )
            (folder / f"i{i}.xml").write_text(f'<scene version="3.0.0">{below}<bsdf type="diffuse"/></scene>')
        (folder / "i6.xml").write_text('<scene version="3.0.0"><bsdf type="diffuse"/></scene>')
        files = [str(file) for file in mi.parser.parse_file(config, str(folder / "i0.xml")).files]
        check_document(folder / "i0.xml")
        if len(files) > len(set(files)):
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr("sarmitsuba.loading.references._MAX_INCLUDES", len(set(files)) - 1)
                with pytest.raises(SceneError, match=f"expand to {len(files) - 1} files"):
                    check_document(folder / "i0.xml")
            compared += 1
    assert compared > 5


def test_what_is_repeated_and_written_out_is_bounded(tmp_path: Path) -> None:
    path = nest(tmp_path, 2, 900)
    part = '<bsdf type="diffuse"/>' * 200
    (tmp_path / "i1.xml").write_text(f'<scene version="3.0.0">{part}</scene>')
    with pytest.raises(SceneError, match="come to 180699 more elements"):
        check_document(path)
    values = ["haha", *(f"$p{i}" * 10 for i in range(11))]
    levels = "".join(f'<default name="p{i}" value="{value}"/>' for i, value in enumerate(values))
    path.write_text(f'<scene version="3.0.0">{levels}</scene>')
    with pytest.raises(
        SceneError, match=r"parameters written out come to .* 4e11 more bytes|1e11 more bytes"
    ):
        check_document(path)
    values = ["haha", *(f"$p{i}" for i in range(49))]
    chain = "".join(f'<default name="p{i}" value="{value}"/>' for i, value in enumerate(values))
    path.write_text(f'<scene version="3.0.0">{chain}<string name="a" value="$p49 $p3 $p30"/></scene>')
    check_document(path)


@pytest.mark.parametrize("kind", ["include", "spectrum", "path"])
def test_files_beside_an_included_file_are_checked_too(tmp_path: Path, kind: str) -> None:
    """Mitsuba looks beside the including file first: a file of that name in the scene's folder hides nothing."""
    folder, sub, outside = tmp_path / "scene", tmp_path / "scene" / "sub", tmp_path / "outside"
    for one in (sub, outside, folder / "part"):
        one.mkdir(parents=True)
    part = '<scene version="3.0.0"/>'
    tag = {
        "include": '<include filename="part"/>',
        "spectrum": '<bsdf type="diffuse"><spectrum name="reflectance" filename="part"/></bsdf>',
        "path": '<path value="part"/>',
    }[kind]
    if kind != "path":
        (folder / "part").rmdir()
        (folder / "part").write_text(part)
        (outside / "part").write_text(part)
    (folder / "s.xml").write_text('<scene version="3.0.0"><include filename="sub/a.xml"/></scene>')
    (sub / "a.xml").write_text(f'<scene version="3.0.0">{tag}</scene>')
    os.symlink(outside if kind == "path" else outside / "part", sub / "part")
    with pytest.raises(SceneError, match=r"lies outside the folder of the scene"):
        check_document(folder / "s.xml")
    (folder / "part").rmdir() if kind == "path" else (folder / "part").unlink()
    (sub / "part").unlink()
    if kind == "path":
        (sub / "part").mkdir()
    else:
        (sub / "part").write_text(part)
    check_document(folder / "s.xml")
