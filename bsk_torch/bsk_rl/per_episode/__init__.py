"""Code for one episode in a batch of episodes: functions, rewarders and targets, and what they read of one episode."""
