"""The manual: pages in Markdown, and the generator of those that follow from the code; `make docs` builds it."""
