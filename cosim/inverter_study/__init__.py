"""What inverters in the machines' place do to the swing, by their share: modes, clearing times, links."""
