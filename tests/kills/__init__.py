"""Kills commands at random moments, or fills their disk, and checks that nothing is lost."""
