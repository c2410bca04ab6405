// Loads the page again after two seconds.
setTimeout(() => location.reload(), 2000);
