"""All verifications of the forward model; they take a few minutes on one core.

Writes verification/validation/output/verification.md and .json. With ``--publish`` the tables also go into the page
docs/results/forward-model.md, their raw numbers into verification.json next to it, and the figures are drawn again.

Run it with:  python -m verification.validation [--publish]
"""

from verification.validation import analytic, biofilm_mesh, figures, generality, sensitivities, turek_hron
from verification.validation.tables import DOCS, OUTPUT, Table, arguments, as_text, put_into_page

PAGE = DOCS / "results" / "forward-model.md"
PARTS = (
    turek_hron.tables,
    analytic.tables,
    biofilm_mesh.tables,
    sensitivities.tables,
    biofilm_mesh.extremes,
    generality.tables,
)

if __name__ == "__main__":
    options, tables = arguments(__doc__, publish=False), list[Table]()
    for part in PARTS:
        tables += part()
        print(f"{tables[-1].title} done", flush=True)
    OUTPUT.mkdir(exist_ok=True)
    text = "\n".join(f"## {table.title}\n\n{table.markdown()}\n" for table in tables)
    (OUTPUT / "verification.md").write_text(f"# Verification of the forward model\n\n{text}", "utf-8")
    (OUTPUT / "verification.json").write_text(as_text(tables), "utf-8")
    if options.publish:
        PAGE.with_name("verification.json").write_text(as_text(tables), "utf-8")
        PAGE.write_text(put_into_page(PAGE.read_text("utf-8"), tables), "utf-8")
        figures.draw(tables, DOCS / "figures")
