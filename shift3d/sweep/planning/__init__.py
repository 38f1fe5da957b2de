"""What a sweep runs: its tasks, their ids, the effects that each scene calls for, and the files that say so."""
