"""Web page of a dataset and of its run: farm, episodes, scenes, statistics and evaluations (docs/web.md).

`create_app` builds the application and `WebServer` serves it. Importing this package imports no web framework.
"""
