"""Pictures of training and of trained policies, written to a file each."""
