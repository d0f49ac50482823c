"""cppcheck's MISRA addon as a module. cppcheck starts an interpreter for every file, which compiles the 4500
lines of the addon anew if they are the script; a module is compiled once. This file has the name of the addon
because cppcheck knows by it that the rules across files come last.
"""

import misra  # cppcheck's: the folder of its addons is first on the path, not this one

misra.main()
