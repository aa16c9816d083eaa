"""What is to be made: request, models and checks, and the plan of the frames."""
