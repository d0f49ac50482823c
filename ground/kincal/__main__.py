from kincal.cli import main

main()
