"""``report.html``: one page that shows an evaluation, without anything outside its file."""
