"""Experiments: datasets, trainings, evaluations and comparisons as stages that are kept by their content.

A request becomes a graph of stages (`prepare`), which is planned (`plan`) or run (`run`); the records of the finished
stages become the page (`results`).
"""
