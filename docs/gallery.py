"""The gallery: every example with what it says of itself, and the picture that it draws.

Written when the documentation is built. The tests run all examples; where ``CAROSAC_ARTIFACTS``
names a folder they leave their pictures there, and CI builds the gallery of these. Elsewhere the
examples run now, each once until it changes.
"""

from __future__ import annotations

import ast
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
EXAMPLES = HERE.parent / "examples"
PICTURES = HERE / "_gallery"  # not under version control, like the page
PAGE = HERE / "gallery.md"
HEAD = """# Gallery

Every example is one file of less than a hundred lines, runs in under a minute and draws one
picture. These were drawn when this page was made.
"""


def make() -> None:
    """Write the page and its pictures."""
    PICTURES.mkdir(exist_ok=True)
    parts = [HEAD, *(_entry(example) for example in sorted(EXAMPLES.glob("[!_]*.py")))]
    text = "\n".join(parts)
    if not PAGE.exists() or PAGE.read_text(encoding="utf-8") != text:
        PAGE.write_text(text, encoding="utf-8")


def _entry(example: Path) -> str:
    """Title, words, picture and source of one example."""
    words = ast.get_docstring(ast.parse(example.read_text(encoding="utf-8"))) or ""
    title, _, rest = words.partition("\n")
    body = rest.rpartition("\n\n")[0].strip()  # the last paragraph says what it writes
    picture = _picture(example)
    return f"""## {title.rstrip(".")}

{body}

![{example.stem}](_gallery/{picture.name})

<details><summary>examples/{example.name}</summary>

```{{literalinclude}} ../examples/{example.name}
:language: python
```

</details>
"""


def _picture(example: Path) -> Path:
    """Its picture: of the tests, of an earlier build, or drawn now."""
    digest = hashlib.sha256(example.read_bytes()).hexdigest()[:8]
    picture = PICTURES / f"{example.stem}-{digest}.png"
    drawn = Path(os.environ.get("CAROSAC_ARTIFACTS", HERE)) / f"{example.stem}.png"
    if drawn.exists():
        shutil.copyfile(drawn, picture)
    elif not picture.exists():
        print(f"gallery: {example.name} draws its picture ...", flush=True)
        environment = dict(os.environ, MPLBACKEND="Agg")
        words = [sys.executable, str(example)]
        subprocess.run(words, cwd=PICTURES, env=environment, check=True, stdout=subprocess.DEVNULL)
        (PICTURES / f"{example.stem}.png").replace(picture)
    return picture
