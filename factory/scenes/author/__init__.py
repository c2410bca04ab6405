"""Authors the built-in scenes from a seed: office, hospital, two warehouses, homes, shops and schools.

A scene is written as USD, which the importer reads like any stage, or converted to the content that the compiler reads.
Does not compile or simulate.
"""
