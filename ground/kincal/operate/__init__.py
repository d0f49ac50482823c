"""What an operator does with flight while it runs: see its state, command it, record the link.

snapshot: the last value of everything that flight said, and how old it is. commands: one command and its
verifiers, without input or output. sender: sends a command once and waits. recording: all messages of the
link in files.
"""
