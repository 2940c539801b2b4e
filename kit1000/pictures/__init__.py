"""Pictures for people: depth images, masks, previews of kits and sheets of a dataset."""
