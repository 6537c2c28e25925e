"""Compiles a function of one lane's numbers to LLVM vector code."""
