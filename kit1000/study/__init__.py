"""User studies: scene editing against hand control, within subjects, with NASA-TLX.

Read it in this order: `plan` (conditions, orders, tasks), `records` (what a participant leaves behind), `clock`,
`questionnaire` and `pages` (parts of a sitting), `sitting` (one participant at the page), `statistics`,
`analysis` and `report`. `command` joins them as `kit1000 study`.
"""
