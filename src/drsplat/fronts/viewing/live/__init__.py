"""One session on show over HTTP: what `drsplat view` serves and its client, a page in a browser, talks to.

`app` has the routes. A browser gets arrays and JSON, sends acts, and hears of each change by server-sent events.
"""
