"""A user study of ways to say where parts go: plan, sittings, simulated operators, statistics and a report.

Read it in this order: `conditions` (what is compared), `tasks` and `study_plan` (who does what in which order),
`clock` and `study_records` (what a trial leaves), `questionnaire`, `execution` (the robot judges), `operators` and
`simulation` (people replaced by models, to test the machine), `finished_trials`, `statistics`, `analysis`, and
`study_report` with `plots`. `command` is what the command line calls.
"""
