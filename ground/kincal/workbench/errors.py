"""The two ways a question can fail: bad input, and data that cannot answer."""


class BadInput(Exception):
    """Something given is wrong: says what, where and what to do. Exit status 2."""

    exit_status = 2


class CannotAnswer(Exception):
    """The input is fine but does not determine the answer. Exit status 3."""

    exit_status = 3
