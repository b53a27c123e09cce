"""What a person did that cannot work, said so that they can mend it."""


class UserError(Exception):
    """A mistake of the user's or of their machine, never of the program's: printed without traceback, exit code 2.

    message names the thing and the value; remedy says what to do about it.
    """

    def __init__(self, message: str, remedy: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.remedy = remedy

    def __str__(self) -> str:
        return f"{self.message}\n  remedy: {self.remedy}" if self.remedy else self.message
