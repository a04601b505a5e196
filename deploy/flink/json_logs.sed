# Makes the appenders of Flink's log4j properties write one JSON object per line, in the Elastic Common Schema.
s|^\(appender\.[a-z]*\.layout\)\.type = PatternLayout|\1.type = JsonTemplateLayout|
s|^\(appender\.[a-z]*\.layout\)\.pattern = .*|\1.eventTemplateUri = classpath:EcsLayout.json|
