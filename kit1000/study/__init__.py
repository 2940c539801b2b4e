"""A user study of ways to say where parts go: plan, sittings, simulated operators, statistics and a report.

Read it in this order: `conditions` (what is compared), `tasks` and `plan` (who does what in which order), `clock` and
`records` (what a trial leaves), `questionnaire`, `execution` (the robot judges), `operators` and `simulation`
(people replaced by models, to test the machine), `reading`, `statistics`, `analysis`, and `report` with `plots`.
`command` is what the command line calls.
"""
