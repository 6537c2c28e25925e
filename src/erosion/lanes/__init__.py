"""Compiles a function of one lane's numbers to LLVM vector code. README.md leads through it by an example."""
