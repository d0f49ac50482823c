"""What ground tool and simulator share: schemas of files, errors, keys of commands, the installation."""
