"""Planning of a sweep: its tasks, their ids, the effects in each scene, and the files that store the plan."""
