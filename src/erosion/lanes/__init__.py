"""Compiles a function of one lane's numbers to LLVM vector code; docs/develop/lanes.md shows how, by an example."""
